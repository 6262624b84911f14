"""What analog photons say of the cells of a pad, traced once and kept beside the tests.

Photons cost some hundred times what the renders cost that are held against them, and tell the same
for every version of the sampler. So those of every case (`tests.oracles.pads`) lie in ``photons/``,
one file a case, with a hash of the case's scene; what is missing, or of another scene, is traced
when it is asked for. That the oracle still says what is kept is a test of its own
(`test_kept_photons`).

``python -m tests.oracles.kept_photons [CASE ...]`` traces what is named anew, or all that
are missing; stopped, it goes on with the next case.
"""

from __future__ import annotations

import argparse
import json
import time
from hashlib import sha256
from pathlib import Path

import numpy as np
from scipy import stats

from render.scene import Scene
from tests.oracles.analog_cells import AnalogScene
from tests.oracles.analog_tracer import Floats
from tests.oracles.mesh_cells import BentScene
from tests.oracles.pads import CASES, content_of_case, scene_of_case

KEPT = Path(__file__).parent / "photons"
PHI = 1.2
"""Direction of the lamps that turn, rad."""
WHOLE = (*CASES, *(f"{kind} {number}" for kind in ("random", "mixed") for number in range(24)))
"""All pads that have photons."""
SENSORS = (
    *(f"shipped {name}" for name in ("digit", "digit-dome", "finger20", "finger24",
                                     "gelsight-flat", "gelsight-mini")),
    *(f"sensor {number}" for number in (2, 4, 6, 10, 13, 19, 20)),
)  # fmt: skip
"""Whole sensors that have them: of many lamps."""
BATCHES = 16
PILOT, LEAST, MOST = 200_000, 4_000_000, 64_000_000
"""Photons of a lamp that say how many are needed, and the bounds of that."""
OF_A_SENSOR = 2_000_000
"""Photons of each of a sensor's many lamps."""
ERROR, ERROR_WHERE_CHEAP = 0.02, 0.0125
"""Relative error of a cell in the median that photons aim at, and among planes without milk."""


def among_planes(scene: Scene, bend: float) -> bool:
    """Return whether photons of the pad meet planes alone; others go among triangles."""
    return not bend and scene.skin is scene.window is None


def analog(
    scene: Scene, pressed: bool, seed: int = 1, bend: float | None = None
) -> AnalogScene | BentScene:
    """Return the pad, pressed at all sites or untouched, as photons have it.

    ``bend`` is in rad (default: the scene's first).
    """
    bend = scene.bending.angles[0] if bend is None else bend
    # Every photon meets the lines of sight of its bin where the skin has a lobe.
    views = 4000 if scene.coating.specular else 20_000
    if among_planes(scene, bend):
        return AnalogScene(scene, pressed, views, seed)
    return BentScene(scene, bend, pressed, views, seed)


def traced(pad: AnalogScene | BentScene, photons: int) -> Floats:
    """Return the transport ``(batch, lamp, cell)`` that so many photons of each lamp bring."""
    lamps = range(pad.scene.lamp_count)
    return np.stack([pad.cells(f, PHI, photons, BATCHES).replicates for f in lamps], axis=1)


def median_error(cells: Floats) -> float:
    """Return that of ``(batch, lamp, cell)``, relative to each; infinite where nothing is lit."""
    mean, error = cells.mean(axis=0), stats.sem(cells)
    lit = mean > 0.0
    return float(np.median(error[lit] / mean[lit])) if lit.any() else np.inf


def photons_kept(case: str, pressed: bool) -> Floats:
    """Return the transport ``(batch, lamp, cell)`` by the photons that are kept of a case.

    Cells are the facets of all sites of the pressed pad, or the sites of the untouched one.
    """
    kept = _read(case)
    if kept is None:
        keep(case)
        kept = _read(case)
    assert kept is not None
    cells = kept["facets" if pressed else "sites"].astype(np.float64)
    return cells.reshape(BATCHES, scene_of_case(case).lamp_count, -1)


def keep(case: str) -> None:
    """Trace a case until its cells are known, and keep it."""
    scene = scene_of_case(case)
    milky = scene.diffuser is not None and scene.diffuser.sigma_s > 0.0
    cheap = among_planes(scene, scene.bending.angles[0]) and not milky
    error = ERROR_WHERE_CHEAP if cheap else ERROR
    began, cells, counts = time.perf_counter(), {}, []
    for name in ("facets", "sites"):
        pad = analog(scene, pressed=name == "facets")
        pilot = traced(pad, PILOT)
        needed = PILOT * (median_error(pilot) / error) ** 2
        photons = int(np.clip(np.ceil(needed / 1e6) * 1e6, LEAST, MOST))
        photons = OF_A_SENSOR if case in SENSORS else photons
        cells[name] = traced(pad, photons).astype(np.float32)
        counts.append(photons)
        print(
            f"{case:40s} {name:6s} {photons / 1e6:3.0f} million of each lamp, known to "
            f"{median_error(cells[name]):.1%} (median), {time.perf_counter() - began:.0f} s",
            flush=True,
        )
    KEPT.mkdir(exist_ok=True)
    # A name of its own until it is whole: two runs may share the folder.
    part = _path(case).with_suffix(".part.npz")
    np.savez_compressed(part, scene=_scene_hash(case), photons=np.array(counts), **cells)
    part.replace(_path(case))


def _read(case: str) -> dict[str, Floats] | None:
    """Return what is kept of a case as it is; None where nothing is."""
    if not _path(case).is_file():
        return None
    with np.load(_path(case)) as kept:
        return None if str(kept["scene"]) != _scene_hash(case) else dict(kept)


def _path(case: str) -> Path:
    return KEPT / f"{case.replace(',', '').replace(' ', '-')}.npz"


def _scene_hash(case: str) -> str:
    """Return what tells a scene from a changed one; last bits of numbers are the machine's."""
    content = content_of_case(case)
    if "mesh" in content.get("skin", {}):
        content["skin"] = scene_of_case(case).skin.model_dump()
    rounded = json.loads(json.dumps(content), parse_float=lambda number: f"{float(number):.9g}")
    return sha256(json.dumps(rounded, sort_keys=True).encode()).hexdigest()[:16]


def main() -> None:
    """Trace the cases that are named, or all that are missing."""
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", nargs="*", metavar="CASE")
    chosen = parser.parse_args()
    for case in chosen.cases or [case for case in (*WHOLE, *SENSORS) if _read(case) is None]:
        keep(case)


if __name__ == "__main__":
    main()
