// Run checker.onnx on its golden input with the C API of onnxruntime and print what comes out.
//
//   g++ -std=c++17 golden.cpp -o golden -I<onnxruntime>/include -L<onnxruntime>/lib -lonnxruntime
//   ./golden [MODEL_FOLDER]
//
// Where <onnxruntime> comes from is in ../README.md: libonnxruntime-dev, or a release's archive.
//
// Compare checker.onnx with checker.sha256 first (sha256sum -c checker.sha256): an altered model
// gives plausible numbers.

#include <cmath>
#include <cstdio>
#include <onnxruntime_c_api.h>

#include "npz.hpp"

namespace {

const char* const INPUTS[] = {"phi", "power", "bend"};
const char* const OUTPUTS[] = {"counts", "counts_spread", "background",
                               "metric", "score",         "domain_excess"};
constexpr size_t OUTPUT_COUNT = 6;

const OrtApi* const ort = OrtGetApiBase()->GetApi(ORT_API_VERSION);

void check(OrtStatus* status) {
    if (!status) return;
    const std::string message = ort->GetErrorMessage(status);
    ort->ReleaseStatus(status);
    throw std::runtime_error(message);
}

int run(const std::string& folder) {
    if (!ort) throw std::runtime_error("the onnxruntime library is older than its header");
    OrtEnv* env = nullptr;
    OrtSessionOptions* options = nullptr;
    OrtSession* session = nullptr;
    OrtMemoryInfo* memory = nullptr;
    check(ort->CreateEnv(ORT_LOGGING_LEVEL_ERROR, "tactilux", &env));
    check(ort->CreateSessionOptions(&options));
    const std::string model = read_file(folder + "/checker.onnx");
    check(ort->CreateSessionFromArray(env, model.data(), model.size(), options, &session));
    check(ort->CreateCpuMemoryInfo(OrtArenaAllocator, OrtMemTypeDefault, &memory));

    // phi (batch, fibers) and bend (batch, bends) in rad, power (batch, fibers, 3) in [0, 1].
    auto golden = read_npz(folder + "/golden.npz");
    const OrtValue* inputs[3] = {};
    for (size_t i = 0; i < 3; ++i) {
        Array& array = golden.at(INPUTS[i]);
        OrtValue* value = nullptr;
        check(ort->CreateTensorWithDataAsOrtValue(
            memory, array.data.data(), array.data.size() * sizeof(float), array.dims.data(),
            array.dims.size(), ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT, &value));
        inputs[i] = value;
    }
    OrtValue* found[OUTPUT_COUNT] = {};
    check(ort->Run(session, nullptr, INPUTS, inputs, 3, OUTPUTS, OUTPUT_COUNT, found));

    float* values[OUTPUT_COUNT] = {};
    double worst = 0.0;
    for (size_t i = 0; i < OUTPUT_COUNT; ++i) {
        const Array& expected = golden.at(OUTPUTS[i]);
        OrtTensorTypeAndShapeInfo* shape = nullptr;
        size_t size = 0;
        check(ort->GetTensorTypeAndShape(found[i], &shape));
        check(ort->GetTensorShapeElementCount(shape, &size));
        ort->ReleaseTensorTypeAndShapeInfo(shape);
        if (size != expected.data.size())
            throw std::runtime_error(std::string(OUTPUTS[i]) + " has another shape");
        check(ort->GetTensorMutableData(found[i], reinterpret_cast<void**>(&values[i])));
        for (size_t k = 0; k < size; ++k) {
            const double off = std::abs(values[i][k] - expected.data[k]);
            if (!(off <= worst)) worst = off;  // NaN counts as wrong
        }
    }
    const size_t batch = golden.at("score").data.size();
    const size_t stride = golden.at("counts").data.size() / batch;
    for (size_t d = 0; d < batch; ++d) {
        const float* facet = values[0] + d * stride;
        std::printf("design %zu: score %.3f, domain excess %g, first facet %.2f %.2f %.2f\n", d,
                    values[4][d], values[5][d], facet[0], facet[1], facet[2]);
    }
    std::printf("largest difference from the golden output: %.2g\n", worst);

    for (OrtValue* value : found) ort->ReleaseValue(value);
    for (const OrtValue* value : inputs) ort->ReleaseValue(const_cast<OrtValue*>(value));
    ort->ReleaseMemoryInfo(memory);
    ort->ReleaseSession(session);
    ort->ReleaseSessionOptions(options);
    ort->ReleaseEnv(env);
    if (worst < 0.01) return 0;
    std::fprintf(stderr, "this runtime computes something else\n");
    return 1;
}

}  // namespace

int main(int count, char** words) {
    try {
        return run(count > 1 ? words[1] : "../../models/finger20");
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}
