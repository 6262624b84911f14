"""A file appears complete under its name and outlasts a loss of power."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from render import files
from render.errors import ReadError, TableError
from tests.disk import DURABLE, logged_disk


def test_every_writer_syncs_the_file_before_its_name_and_the_folder_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = logged_disk(monkeypatch)
    files.write_bytes(tmp_path / "new" / "a.bin", b"a")
    files.write_text(tmp_path / "a.txt", "ä")
    files.write_json(tmp_path / "a.json", {"a": [1.5]})
    files.write_npz(tmp_path / "a.npz", {"a": np.arange(3.0)})
    # The name of the new folder too.
    assert calls == ["sync folder", *DURABLE * 4]
    assert (tmp_path / "new" / "a.bin").read_bytes() == b"a"
    assert (tmp_path / "a.txt").read_bytes() == "ä".encode()
    assert files.read_json(tmp_path / "a.json") == {"a": [1.5]}
    assert files.read_npz(tmp_path / "a.npz")["a"].tolist() == [0.0, 1.0, 2.0]


def test_arrays_are_written_without_a_copy_of_them(tmp_path: Path) -> None:
    arrays = {"a": np.arange(8e6), "b": np.ones(3)}
    tracemalloc.start()
    files.write_npz(tmp_path / "a.npz", arrays)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 0.5 * arrays["a"].nbytes
    assert (tmp_path / "a.npz").read_bytes() == files.npz_bytes(arrays)
    np.testing.assert_array_equal(files.read_npz(tmp_path / "a.npz", sealed=True)["a"], arrays["a"])


def test_what_could_not_be_read_again_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files.write_npz(tmp_path / "a.npz", {"a": np.zeros(3)})
    monkeypatch.setattr(files, "LARGEST", 1000)
    for write in (
        lambda: files.write_npz(tmp_path / "a.npz", {"a": np.zeros(100)}),
        lambda: files.write_json(tmp_path / "a.json", {"a": "x" * 1000}),
    ):
        with pytest.raises(OSError, match=r"it has 1,\d+ bytes, allowed: up to 1,000"):
            write()
    assert [item.name for item in tmp_path.iterdir()] == ["a.npz"]
    assert files.read_npz(tmp_path / "a.npz")["a"].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null"])
def test_a_device_is_refused_before_it_is_read(device: str, tmp_path: Path) -> None:
    link = tmp_path / "link.npz"
    link.symlink_to(device)
    with pytest.raises(OSError, match="it is a device, no file"):
        files.read_bytes(link)
    with pytest.raises(ValueError, match="cannot be read: it is a device, no file"):
        files.read_text(link)
    with pytest.raises(TableError, match="it is a device, no file"):
        files.read_npz(link)
    assert files.read_json(link) == {}


def test_a_pipe_is_read_to_its_end() -> None:
    reader, writer = os.pipe()
    os.write(writer, b"[pad]\r\n")
    os.close(writer)
    assert files.read_text(Path(f"/dev/fd/{reader}")) == "[pad]\n"
    os.close(reader)


def test_an_error_half_way_leaves_the_earlier_file_and_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "a"
    files.write_text(path, "first")

    def fail_half_way() -> None:
        with files.replacing(path) as stream:
            stream.write(b"half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_half_way()
    assert path.read_text() == "first"
    assert [item.name for item in tmp_path.iterdir()] == ["a"]


def test_an_unfinished_file_has_a_name_by_which_it_is_found(tmp_path: Path) -> None:
    assert files.TEMPORARY.fullmatch(files.temporary_name(tmp_path / "a.npz").name)
    assert not files.TEMPORARY.fullmatch("a.npz")


@pytest.mark.parametrize("content", ["", "[1]", '{"a": ', "\udcff"])
def test_a_damaged_object_reads_as_none_was_there(tmp_path: Path, content: str) -> None:
    path = tmp_path / "plan.json"
    assert files.read_json(path) == {}
    path.write_bytes(content.encode("utf-8", "surrogateescape"))
    assert files.read_json(path) == {}


def test_a_folder_of_the_system_that_takes_no_files_is_no_place_for_one(tmp_path: Path) -> None:
    assert files.can_create(tmp_path / "new" / "a")
    assert not list(tmp_path.iterdir())
    assert not files.can_create(Path("/proc/a"))
    (tmp_path / "file").touch()
    assert not files.can_create(tmp_path / "file" / "a")


def short_of(error: Exception) -> Callable[..., None]:
    """Return what fails with ``error`` instead of reading, as on a machine that is short of it."""

    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "there is not enough memory; close other programs and try again"),
        (
            OSError(errno.EMFILE, "Too many open files"),
            "Too many open files; close other programs and try again",
        ),
        (OSError(errno.EACCES, "Permission denied"), "Permission denied; mend that and try again"),
        (OSError(errno.EIO, "Input/output error"), "Input/output error; mend that and try again"),
    ],
    ids=["memory", "handles", "rights", "disk"],
)
def test_a_kept_file_outlives_a_shortage_which_is_one_sentence(
    error: Exception, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "kept.passes.npz"
    files.write_npz(path, {"estimate": np.arange(3.0)})
    with monkeypatch.context() as short:
        short.setattr(np, "load", short_of(error))
        with pytest.raises(ReadError) as raised:
            files.read_or_drop(path, "estimate")
    assert str(raised.value) == f"{path} cannot be read, and is left as it is: {said}"
    kept = files.read_or_drop(path, "estimate")
    assert kept is not None
    assert kept["estimate"].tolist() == [0.0, 1.0, 2.0]


def test_a_header_that_damage_makes_absurd_is_no_shortage(tmp_path: Path) -> None:
    path = tmp_path / "kept.npz"
    stream = io.BytesIO()
    np.savez(stream, estimate=np.arange(3.0))
    content = stream.getvalue()
    assert content.count(b"(3,), }             ") == 1
    path.write_bytes(content.replace(b"(3,), }             ", b"(3000000000000000,)}"))
    with pytest.raises(TableError, match="it is damaged"):
        files.read_npz(path)
    assert files.read_or_drop(path) is None
    assert not path.exists()


@pytest.mark.parametrize("content", [b"", b"half", b"PK\5\6"])
def test_what_is_damaged_or_lacks_a_name_is_taken_away(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "kept.npz"
    path.write_bytes(content)
    assert files.read_or_drop(path) is None
    assert not path.exists()
    files.write_npz(path, {"other": np.arange(3.0)})
    assert files.read_or_drop(path, "estimate") is None
    assert not path.exists()


def test_a_member_that_would_lie_before_the_beginning_is_damage(tmp_path: Path) -> None:
    stream = io.BytesIO()
    np.savez(stream, a=np.arange(3.0))
    with zipfile.ZipFile(stream) as archive:
        start = archive.start_dir
    content = bytearray(stream.getvalue())
    del content[start - 20 : start]
    path = tmp_path / "kept.npz"
    path.write_bytes(content)
    assert files.read_or_drop(path) is None
    assert not path.exists()


def test_what_another_process_takes_away_meanwhile_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "kept.npz"
    path.write_bytes(b"half")
    read = files.read_npz

    def read_late(path: Path) -> dict[str, np.ndarray]:
        try:
            return read(path)
        finally:
            path.unlink()

    monkeypatch.setattr(files, "read_npz", read_late)
    assert files.read_or_drop(path) is None


def flipped(content: bytes, bit: int) -> bytes:
    """Return ``content`` with one bit turned."""
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def test_no_single_bit_of_an_archive_turns_without_being_noticed(tmp_path: Path) -> None:
    path = tmp_path / "kept.npz"
    files.write_npz(path, {"a": np.arange(3.0), "key": np.array("abc")})
    content = path.read_bytes()
    assert files.read_npz(path)["a"].tolist() == [0.0, 1.0, 2.0]
    silent = []
    for bit in range(0, 8 * len(content), 3):
        path.write_bytes(flipped(content, bit))
        try:
            files.read_npz(path)
        except TableError:
            continue
        silent.append(bit)
    assert not silent


def test_no_single_bit_of_an_object_turns_without_being_noticed(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    for content in ({"samples": 1024, "seeds": [1, 2]}, {}):
        files.write_json(path, content, indent=2)
        written = path.read_bytes()
        assert files.read_json(path) == content
        silent = []
        for bit in range(8 * len(written)):
            path.write_bytes(flipped(written, bit))
            with contextlib.suppress(ValueError):
                files.read_sealed(path)
                silent.append(bit)
        # The end of the last line may be another blank.
        assert all(bit // 8 == len(written) - 1 for bit in silent)


def test_files_without_a_seal_are_of_an_earlier_version_and_read(tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text('{"samples": 1024}\n')
    np.savez(tmp_path / "kept.npz", a=np.arange(3.0))
    assert files.read_json(tmp_path / "plan.json") == {"samples": 1024}
    assert files.read_npz(tmp_path / "kept.npz")["a"].tolist() == [0.0, 1.0, 2.0]


def test_a_pipe_in_a_folder_and_a_file_without_end_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.npz")
    with (tmp_path / "endless").open("wb") as stream:
        stream.truncate(files.LARGEST + 1)
    with pytest.raises(OSError, match="it is a pipe, no file"):
        files.read_bytes(tmp_path / "pipe.npz")
    with pytest.raises(TableError, match="it is a pipe, no file"):
        files.read_npz(tmp_path / "pipe.npz")
    with pytest.raises(OSError, match="allowed: up to 1,073,741,824"):
        files.read_bytes(tmp_path / "endless")


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        (files.parse_toml, f"[{'.'.join('a' * 1500)}]"),
        (files.parse_toml, f"a = {'[' * 60}{']' * 60}"),
        (files.parse_toml, f"a = {'{a = ' * 5000}1{'}' * 5000}"),
        (files.parse_json, f"{'[' * 60}{']' * 60}"),
        (files.parse_json, f"{'[' * 100_000}{']' * 100_000}"),
        (files.parse_json, '{"a": ' * 60 + "1" + "}" * 60),
    ],
)
def test_what_lies_too_deep_is_one_sentence(parse: Callable[[str], object], text: str) -> None:
    with pytest.raises(ValueError, match="its tables and lists lie more than 50 deep in each othe"):
        parse(text)
    assert files.parse_json(f"{'[' * 50}1{']' * 50}")
    assert files.parse_json("5") == 5


def test_an_archive_that_unpacks_to_far_more_than_it_is_is_not_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """300 MB of zeros in 0.3 MB: not even numpy sees them."""
    path = tmp_path / "bomb.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("a.npy", "w") as a,
    ):
        np.lib.format.write_array_header_1_0(
            a, {"descr": "|u1", "fortran_order": False, "shape": (300_000_000,)}
        )
        for _ in range(300):
            a.write(bytes(1_000_000))
    assert path.stat().st_size < 400_000
    monkeypatch.setattr(np, "load", short_of(AssertionError("it was unpacked")))
    with pytest.raises(
        TableError, match=r"would unpack to 300 MB, allowed: up to 256 MB, or 20 ti"
    ):
        files.read_npz(path)


def test_a_header_that_promises_more_than_its_file_is_damage_and_no_want_of_memory(
    tmp_path: Path,
) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_2_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
    )
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", header.getvalue() + bytes(800))
    with pytest.raises(TableError, match="it is damaged, or holds no arrays"):
        files.read_npz(tmp_path / "a.npz")


def test_a_text_in_utf_16_is_read_by_its_mark(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_bytes("[pad]\r\nname = 'ä'".encode("utf-16"))
    assert files.read_text(tmp_path / "a.toml") == "[pad]\nname = 'ä'"


def test_a_text_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with (tmp_path / "a.toml").open("wb") as stream:
        stream.truncate(10**11)
    with pytest.raises(ValueError, match="allowed: up to 4,000,000"):
        files.read_text(tmp_path / "a.toml")
