"""Opening a model file: its checksum first, then what it says it is, then the runtime."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from render.errors import ModelError, TableError
from render.files import read_bytes, read_json, read_npz
from surrogate.runtime.graph import check_graph
from surrogate.runtime.metadata import ModelMetadata, read_props

MODEL_FILE, CARD_FILE = "checker.onnx", "checker.md"
SUM_FILE, GOLDEN_FILE = "checker.sha256", "golden.npz"
SECONDS_FILE = "seconds.json"
"""How long a model was rendered and fitted: apart from it, so that equal models have one hash."""
INPUTS = ("phi", "power", "bend")
MATERIAL = "material"
"""A fourth input of models whose scene leaves its material free."""
OUTPUTS = ("counts", "counts_spread", "background", "metric", "score", "domain_excess")
SUMMED = (MODEL_FILE, GOLDEN_FILE)
LARGEST = 5_000_000
"""A model's size in bytes is below this."""
REPLAY_SECONDS = 60.0
"""The golden pair takes milliseconds."""


def sha256(content: bytes) -> str:
    """Return the checksum as ``sha256sum`` prints it."""
    return hashlib.sha256(content).hexdigest()


def sums_of(contents: Mapping[str, bytes]) -> str:
    """Return what `SUM_FILE` says of files: what ``sha256sum`` prints."""
    return "".join(f"{sha256(content)}  {name}\n" for name, content in contents.items())


def rendering_seconds(file: Path) -> float | None:
    """Return what the renders took of the model in ``file``; None where nothing says so."""
    seconds = read_json(file.with_name(SECONDS_FILE)).get("rendering")
    return float(seconds) if isinstance(seconds, int | float) else None


def read_verified(file: Path, *, strict: bool) -> bytes:
    """Return the content of ``file`` after comparing it with the checksum beside it.

    Raises:
        ModelError: unreadable or altered; with ``strict`` also when there is no checksum.
    """
    try:
        content = read_bytes(file, LARGEST)
    except OSError as error:
        raise ModelError(
            f"{file} cannot be read ({error.strerror}): name a folder with {MODEL_FILE}",
            field="model",
        ) from None
    try:
        lines = read_bytes(file.parent / SUM_FILE, LARGEST).decode("ascii").splitlines()
        pairs = [line.split(maxsplit=1) for line in lines if line.strip()]
        sums = {name: checksum for checksum, name in pairs}
    except (OSError, ValueError):
        sums = {}
    for name in SUMMED if strict else (file.name,):
        expected = sums.get(name)
        if expected is None and strict:
            raise ModelError(
                f"{file.parent} has no checksum of {name} in {SUM_FILE}: take a fresh copy of the "
                "model folder",
                field=SUM_FILE,
            )
        if expected is not None and expected != _sum_of(file, name, content):
            raise ModelError(
                f"{file.with_name(name)} was altered: its checksum is not the one in {SUM_FILE}; "
                "take a fresh copy of the model",
                field=name,
            )
    return content


def _sum_of(file: Path, name: str, content: bytes) -> str:
    """Return the checksum of ``name`` beside ``file``, whose ``content`` is read; "" without."""
    if name == file.name:
        return sha256(content)
    try:
        return sha256(read_bytes(file.with_name(name), LARGEST))
    except OSError:
        return ""


def described(path: Path) -> tuple[bytes, ModelMetadata, Path]:
    """Return a model in a folder or a file that has not run yet, what it says of itself, its file.

    Raises:
        ModelError: missing, altered, or none of our graphs.
    """
    file = path / MODEL_FILE if path.is_dir() else path
    content = read_verified(file, strict=path.is_dir())
    try:
        said = check_graph(content)
    except ValueError as error:  # UnicodeDecodeError is one
        raise ModelError(
            f"{file} is no model of ours: {error}; take a fresh copy of the model", field="model"
        ) from None
    return content, read_props(said, str(file)), file


def open_session(content: bytes, file: Path, threads: int | None) -> Any:
    """Return the onnxruntime session of ``content``, which `described` has checked.

    Raises:
        ModelError: onnxruntime cannot run it, or it has other inputs or outputs.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # its complaints reach the user as our own sentence
    if threads is not None:
        options.intra_op_num_threads = threads
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except failures() as error:
        raise failed(file, error) from None
    _check_signature(session, file)
    return session


def failures() -> tuple[type[Exception], ...]:
    """Return all that onnxruntime raises, whose errors have no base of their own."""
    from onnxruntime.capi import onnxruntime_pybind11_state as state

    own = [value for value in vars(state).values() if isinstance(value, type)]
    return (RuntimeError, ValueError, *(kind for kind in own if issubclass(kind, Exception)))


def failed(file: Path | None, error: Exception) -> ModelError:
    """Return the one sentence for what the runtime said of a model."""
    import onnxruntime

    reason = " ".join(str(error).split())[:160]
    return ModelError(
        f"{file or 'the model'} cannot be run by onnxruntime {onnxruntime.__version__} ({reason}): "
        "take a fresh copy of the model or a newer onnxruntime",
        field="model",
    )


def replay(session: Any, file: Path) -> dict[str, np.ndarray] | None:
    """Run the golden pair beside ``file`` once and return its outputs; None without one.

    Raises:
        ModelError: the pair is damaged, or the model says something else or nothing within
            `REPLAY_SECONDS`.
    """
    import onnxruntime

    beside = file.with_name(GOLDEN_FILE)
    if not beside.is_file():
        return None
    try:
        golden = read_npz(beside)
        inputs = {value.name: golden[value.name] for value in session.get_inputs()}
        wanted = {name: golden[name] for name in OUTPUTS}
    except (TableError, KeyError) as error:
        raise ModelError(
            f"{beside} is no golden pair of a model ({error}): take a fresh copy of the model",
            field=GOLDEN_FILE,
        ) from None
    options = onnxruntime.RunOptions()
    clock = threading.Timer(REPLAY_SECONDS, setattr, (options, "terminate", True))
    clock.daemon = True
    clock.start()
    try:
        found = dict(zip(OUTPUTS, session.run(list(OUTPUTS), inputs, options), strict=True))
    except failures() as error:
        raise failed(file, error) from None
    finally:
        clock.cancel()
    for name, value in wanted.items():
        if value.shape != found[name].shape or not np.allclose(
            found[name], value, rtol=1e-3, atol=1e-2, equal_nan=True
        ):
            raise ModelError(
                f"{file} does not say what its golden pair says ({name}): take a fresh copy of the "
                "model, or a version of onnxruntime that runs it",
                field=GOLDEN_FILE,
            )
    return found


def _check_signature(session: Any, file: Path) -> None:
    found = [i.name for i in session.get_inputs()], [o.name for o in session.get_outputs()]
    if found not in [([*INPUTS, *more], list(OUTPUTS)) for more in ([], [MATERIAL])]:
        raise ModelError(
            f"{file} has inputs {found[0]} and outputs {found[1]}, allowed: {list(INPUTS)} (and "
            f"{MATERIAL!r}) and {list(OUTPUTS)}; train the model again",
            field="model",
        )
