// Reads the float32 arrays of an .npz file that numpy.savez wrote: a zip of uncompressed .npy files.
#pragma once

#include <cstdint>
#include <cstring>
#include <fstream>
#include <iterator>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

struct Array {
    std::vector<int64_t> dims;
    std::vector<float> data;
};

inline std::string read_file(const std::string& path) {
    std::ifstream stream(path, std::ios::binary);
    if (!stream) throw std::runtime_error(path + " cannot be read");
    return {std::istreambuf_iterator<char>(stream), {}};
}

// Little-endian integers, as zip and npy store them.
inline uint32_t integer(const std::string& bytes, size_t at, int size) {
    if (at + size > bytes.size()) throw std::runtime_error("the archive ends early");
    uint32_t value = 0;
    for (int i = size - 1; i >= 0; --i) value = value << 8 | static_cast<uint8_t>(bytes[at + i]);
    return value;
}

inline Array read_npy(const std::string& bytes, size_t start) {
    const bool wide = integer(bytes, start + 6, 1) > 1;
    const size_t length = integer(bytes, start + 8, wide ? 4 : 2);
    const size_t first = start + (wide ? 12 : 10);
    const std::string header = bytes.substr(first, length);
    if (header.find("'<f4'") == std::string::npos || header.find("True") != std::string::npos)
        throw std::runtime_error("cannot read " + header);
    Array array;
    size_t size = 1, at = header.find('(') + 1;
    while (header[at] != ')') {
        if (header[at] >= '0' && header[at] <= '9') {
            size_t used = 0;
            array.dims.push_back(std::stoll(header.substr(at), &used));
            size *= array.dims.back();
            at += used;
        } else {
            ++at;
        }
    }
    if (first + length + 4 * size > bytes.size())
        throw std::runtime_error("the archive ends early");
    array.data.resize(size);
    std::memcpy(array.data.data(), bytes.data() + first + length, 4 * size);
    return array;
}

inline std::map<std::string, Array> read_npz(const std::string& path) {
    const std::string bytes = read_file(path);
    size_t end = bytes.size() < 22 ? 0 : bytes.size() - 22;
    while (end > 0 && integer(bytes, end, 4) != 0x06054b50) --end;
    if (end == 0) throw std::runtime_error(path + " is not a zip archive");
    std::map<std::string, Array> arrays;
    size_t at = integer(bytes, end + 16, 4);
    for (uint32_t i = 0; i < integer(bytes, end + 10, 2); ++i) {
        if (integer(bytes, at + 10, 2) != 0) throw std::runtime_error(path + " is compressed");
        const size_t name_length = integer(bytes, at + 28, 2);
        const size_t local = integer(bytes, at + 42, 4);
        const size_t skip = integer(bytes, local + 26, 2) + integer(bytes, local + 28, 2);
        const std::string name = bytes.substr(at + 46, name_length - 4);  // without ".npy"
        arrays[name] = read_npy(bytes, local + 30 + skip);
        at += 46 + name_length + integer(bytes, at + 30, 2) + integer(bytes, at + 32, 2);
    }
    return arrays;
}
