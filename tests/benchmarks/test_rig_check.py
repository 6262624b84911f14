"""What a check costs, against the bound of 50 ms on two cores, and what it finds."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from hw.check.prediction import SiteSpots, predict
from hw.check.rig_tolerances import STARTS, rig_tolerances
from hw.check.sweep_check import check_sweep
from render.geometry import flat_sites
from render.scene import load_scene
from surrogate.runtime import Checker
from tests.hw.random_rigs import MIN_RECALL, measure_recall

MODEL = Path(__file__).parents[2] / "models" / "finger20"
BOUND = 0.050
RIGS = 60


def test_a_check_and_its_recall() -> None:
    checker = Checker.load(MODEL, threads=2)
    scene = load_scene("finger20")
    power = np.eye(3)[np.arange(20) % 3]
    began = time.perf_counter()
    prediction = predict(checker, np.full(20, np.pi / 2), power, 0.0)
    prepared = time.perf_counter() - began
    began = time.perf_counter()
    spots = SiteSpots(scene, 0.0)
    placed = time.perf_counter() - began
    photos = np.random.default_rng(0).uniform(
        0.0, 1e-6, (20, scene.camera.rows, scene.camera.columns, 3)
    )
    known = rig_tolerances(sweep=True, starts=STARTS, noise=np.array(0.1))
    taken = []
    for _ in range(15):
        began = time.perf_counter()
        colors = np.stack([spots.colors(photo) for photo in photos])
        check_sweep(prediction, prediction.alone + colors, known)
        taken.append(time.perf_counter() - began)
    best = min(taken)
    print(
        f"\ncheck of a sweep, from 20 photographs to the diagnosis: {1e3 * best:.1f} ms, "
        f"{best / BOUND:.2f} of the bound; once per design: prediction {1e3 * prepared:.0f} ms, "
        f"places of the sites {1e3 * placed:.0f} ms"
    )
    found = measure_recall(prediction, flat_sites(scene)[:, :2], rigs=RIGS, seed=1)
    for one in found:
        parts = ", ".join(f"{fault} {100 * part:.0f} %" for fault, part in one.found.items())
        print(f"{one.way}: {parts}; false alarms {100 * one.false_alarms:.1f} % of {RIGS} rigs")
    assert min(found[0].found.values()) >= MIN_RECALL
