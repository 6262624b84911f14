"""Opening a model file: the checksum first, then the runtime, then what the file says it is."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from render.errors import ModelError
from render.files import read_bytes

MODEL_FILE, CARD_FILE, SUM_FILE, GOLDEN_FILE = (
    "checker.onnx",
    "checker.md",
    "checker.sha256",
    "golden.npz",
)
INPUTS = ("phi", "power", "bend")
MATERIAL = "material"
"""A fourth input of models whose scene leaves its material free."""
OUTPUTS = ("counts", "counts_spread", "background", "metric", "score", "domain_excess")


SUMMED = (MODEL_FILE, GOLDEN_FILE)


def sha256(content: bytes) -> str:
    """Return the checksum as ``sha256sum`` prints it."""
    return hashlib.sha256(content).hexdigest()


def sums_of(contents: Mapping[str, bytes]) -> str:
    """Return what `SUM_FILE` says of files: what ``sha256sum`` prints."""
    return "".join(f"{sha256(content)}  {name}\n" for name, content in contents.items())


def read_verified(file: Path, *, strict: bool) -> bytes:
    """Return the content of ``file`` after comparing it with the checksum beside it.

    Raises:
        ModelError: unreadable or altered; with ``strict`` also when there is no checksum.
    """
    try:
        content = read_bytes(file)
    except OSError as error:
        raise ModelError(
            f"{file} cannot be read ({error.strerror}): name a folder with {MODEL_FILE}",
            field="model",
        ) from None
    try:
        lines = read_bytes(file.parent / SUM_FILE).decode("ascii").splitlines()
        pairs = [line.split(maxsplit=1) for line in lines if line.strip()]
        sums = {name: checksum for checksum, name in pairs}
    except (OSError, ValueError):
        sums = {}
    expected = sums.get(file.name)
    if expected is None and strict:
        raise ModelError(
            f"{file.parent} has no checksum of {file.name} in {SUM_FILE}: take a fresh copy of the "
            "model folder",
            field=SUM_FILE,
        )
    if expected is not None and expected != sha256(content):
        raise ModelError(
            f"{file} was altered: its checksum is not the one in {SUM_FILE}; take a fresh copy of "
            "the model",
            field=MODEL_FILE,
        )
    return content


def open_session(content: bytes, file: Path, threads: int | None) -> Any:
    """Return the onnxruntime session of ``content``, checked to be one of our graphs.

    Raises:
        ModelError: onnxruntime cannot run it, or it has other inputs or outputs.
    """
    import onnxruntime
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # its complaints reach the user as our own sentence
    if threads is not None:
        options.intra_op_num_threads = threads
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except (
        state.InvalidProtobuf,
        state.InvalidGraph,
        state.InvalidArgument,
        state.NotImplemented,
        state.Fail,
        state.RuntimeException,
    ) as error:
        reason = " ".join(str(error).split())[:160]
        raise ModelError(
            f"{file} cannot be run by onnxruntime {onnxruntime.__version__} ({reason}): take a "
            "fresh copy of the model or a newer onnxruntime",
            field="model",
        ) from None
    _check_signature(session, file)
    return session


def _check_signature(session: Any, file: Path) -> None:
    found = [i.name for i in session.get_inputs()], [o.name for o in session.get_outputs()]
    if found not in [([*INPUTS, *more], list(OUTPUTS)) for more in ([], [MATERIAL])]:
        raise ModelError(
            f"{file} has inputs {found[0]} and outputs {found[1]}, allowed: {list(INPUTS)} (and "
            f"{MATERIAL!r}) and {list(OUTPUTS)}; train the model again",
            field="model",
        )
