"""Commands that are long on a real sensor, on the tiny one: what is asked and what is left."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

import tactilux
from optimize.design import Design, save_design
from render.files import read_npz
from render.scene import load_scene
from tests.optimize.overnight.tiny import outcome

SAMPLES = 8
NAMES = ("overnight", "train", "verify", "explore")


def words_of(name: str, scene: Path, folder: Path) -> list[object]:
    """Return the words of a command of `NAMES` that writes into ``folder``."""
    if name == "verify":
        design = scene.with_name("design.json")
        if not design.exists():
            tiny = load_scene(scene)
            phi, power = np.linspace(1.0, 2.0, tiny.lamp_count), np.eye(3)[[0, 1, 2, 0, 1]]
            asked = Design(phi, power, tiny.palette)
            rated = tactilux.rate(asked, tiny, model=tactilux.load_model(tiny, coarse=True))
            save_design(design, asked, tiny, rated.rating)
        return [name, design, "--out", folder / "out", "--samples", SAMPLES, "--seeds", 4]
    amount = [] if name == "explore" else ["--samples", SAMPLES]
    return [name, scene, "--out", folder / "out", *amount]


def left_by(name: str, folder: Path) -> dict[str, object]:
    """Return the SHA-256 of all that a command leaves and that no clock has a part in."""
    out = folder / "out"
    if name == "overnight":
        return outcome(out)
    if name == "verify":
        renders = {path.name: read_npz(path)["estimate"] for path in out.glob("*.npz")}
        assert len(renders) == 8
        return {name: estimate.tobytes() for name, estimate in renders.items()}
    files = ("design.json",) if name == "explore" else ("checker.onnx", "golden.npz")
    return {file: hashlib.sha256((out / file).read_bytes()).hexdigest() for file in files}
