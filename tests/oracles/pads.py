"""Pads to hold level 2 against: clear or with a rim, smooth or rough, lit near and far, bent."""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import Any

from render.scene import Scene
from tests.oracles.pad_parts import (
    ARCH,
    BASE,
    BELOW_THE_PAD,
    CAST_IN,
    CLEAR_RIM,
    COSINE_8,
    DEG,
    DOME,
    GAUSSIAN,
    MESH,
    MM,
    RIM,
    listed,
    lobe,
    painted,
    rim_on,
    rough,
    row,
    window,
)
from tests.oracles.random_pads import mixed_case, random_case
from tests.oracles.random_scenes import random_content

CASES: dict[str, dict[str, Any]] = {
    "smooth": {},
    "rough 0.01": {"pad.roughness": (0.01,)},
    "rough 0.03": {"pad.roughness": (0.03,)},
    "rough 0.1": {"pad.roughness": (0.1,)},
    "no face": {"pad.index": (1.0,)},
    "index 1.7": {"pad.index": (1.7,)},
    "index 1.7 rough 0.03": {"pad.index": (1.7,), "pad.roughness": (0.03,)},
    "small lamp": {"fibers.diameter": (0.1, MM), "fibers.gap": (0.1, MM)},
    "small near lamp": {"fibers.diameter": (0.09, MM), "fibers.gap": (0.05, MM),
                        "fibers.height": (3.0, MM)},
    "large lamp": {"fibers.diameter": (3.0, MM), "fibers.gap": (1.6, MM)},
    "far lamp": {"fibers.gap": (10.0, MM), "fibers.tilt": (0.0, DEG)},
    "far small lamp rough 0.01": {"fibers.gap": (10.0, MM), "fibers.diameter": (0.1, MM),
                                  "pad.roughness": (0.01,)},
    "narrow": {"fibers.sigma_v": (1.0, DEG), "fibers.tilt": (35.0, DEG)},
    "narrow rough 0.03": {"fibers.sigma_v": (1.0, DEG), "fibers.tilt": (35.0, DEG),
                          "pad.roughness": (0.03,)},
    "narrow 3 deg": {"fibers.sigma_v": (3.0, DEG), "fibers.tilt": (20.0, DEG)},
    "narrow 6 deg": {"fibers.sigma_v": (6.0, DEG), "fibers.tilt": (35.0, DEG)},
    "narrow 10 deg": {"fibers.sigma_v": (10.0, DEG)},
    "narrow, clear rim": {
        "fibers.sigma_v": (1.0, DEG), "fibers.tilt": (35.0, DEG), "diffuser": CLEAR_RIM,
    },
    "wide": {"fibers.sigma_v": (89.0, DEG)},
    "wide no face": {"fibers.sigma_v": (89.0, DEG), "pad.index": (1.0,)},
    "half below": {"fibers.height": (0.0, MM), "fibers.sigma_v": (60.0, DEG),
                   "fibers.tilt": (20.0, DEG)},
    "half below large rough 0.1": {"fibers.height": (0.0, MM), "fibers.diameter": (3.0, MM),
                                   "fibers.gap": (1.6, MM), "pad.roughness": (0.1,),
                                   "fibers.sigma_v": (60.0, DEG), "fibers.tilt": (20.0, DEG)},
    "downwards": {"fibers.height": (4.0, MM), "fibers.tilt": (-30.0, DEG)},
    "rim": {"diffuser": RIM},
    "rim rough 0.1": {"diffuser": RIM, "pad.roughness": (0.1,)},
    "rim no face": {"diffuser": RIM, "pad.index": (1.0,)},
    "rim rough 0.1 bent 45": {
        "diffuser": RIM,
        "pad.roughness": (0.1,),
        "bending.angles": ([45.0], DEG),
    },
    "rim rough 0.1 bent 90": {
        "diffuser": RIM,
        "pad.roughness": (0.1,),
        "bending.angles": ([90.0], DEG),
    },
    "rim bent 45": {"diffuser": RIM, "bending.angles": ([45.0], DEG)},
    "smooth bent 45": {"bending.angles": ([45.0], DEG)},
    "clear rim": {"diffuser": CLEAR_RIM},
    "base": {"rows": [row("base", 2)]},
    "base rough 0.1": {"rows": [row("base", 2)], "pad.roughness": (0.1,)},
    "base beside a rim": {"rows": [row("base", 2), row("left", 1)], "diffuser": RIM},
    "rows of their own": {
        "rows": [
            row("left", 1, height=1.0, diameter=0.5, profile=GAUSSIAN),
            row("right", 1, height=3.5, gap=2.0, tilt=-15.0, profile=COSINE_8, turns=False),
        ],
    },
    "row nearer than wide": {"rows": [row("left", 2, diameter=1.6, gap=0.2, turns=False)]},
    "row touching": {"rows": [row("tip", 2, gap=0.0, tilt=0.0, turns=False)]},
    "below": {"lamps": [listed(-6, -3, -4, 1, 0.5, 2), listed(3, 8, -8, 0, -1, 3, 6.0)]},
    "narrow from below": {
        "lamps": [listed(-6, -3, -4, 1, 0.5, 2, 16.0), listed(3, 8, -8, 0, -1, 3, 16.0)],
    },
    "below rough 0.1": {
        "lamps": [listed(-6, -3, -4, 1, 0.5, 2), listed(3, 8, -8, 0, -1, 3, 6.0)],
        "pad.roughness": (0.1,),
    },
    "below touching": {"lamps": [listed(-7, 2, 0, 0, 0, 1), listed(6, -8, 0, 0, 0, 1)]},
    "below beside the pad": {"lamps": [listed(-13, 2, -3, 2, 0, 1), listed(4, 15, -5, 0, -1, 1)]},
    "below a rim rough 0.1": {
        "lamps": [listed(-6, -3, -4, 1, 0.5, 2)], "diffuser": RIM, "pad.roughness": (0.1,),
    },
    "beside a corner": {"lamps": [listed(-12, 14, 2, 1, -1, 0), listed(12, 14, -2, -1, -1, 1)]},
    "rough edges": {"faces": [rough(0.3, "left", "tip", "right")]},
    "rough edges bent 45": {
        "faces": [rough(0.3, "left", "tip", "right")], "bending.angles": ([45.0], DEG),
    },
    "rough lower": {"faces": [rough(0.1, "lower")]},
    "index 1.7, rough base": {
        "pad.index": (1.7,), "rows": [row("tip", 1, diameter=0.3, gap=4.0)],
        "faces": [rough(0.3, "base")],
    },
    "rough left and lower, smooth tip": {
        "pad.roughness": (0.2,), "faces": [rough(0.0, "tip", "base"), rough(0.05, "lower")],
    },
    "rim over smooth lower": {
        "diffuser": RIM, "pad.roughness": (0.1,), "faces": [rough(0.0, "lower")],
    },
    "rim over rough lower": {"diffuser": RIM, "faces": [rough(0.1, "lower")]},
    "black walls": {"faces": [painted("black", "right", "base")]},
    "white walls": {"faces": [painted("white", "right", "base", reflectance=0.8)]},
    "white walls rough 0.1": {
        "faces": [painted("white", "right", "base", reflectance=0.8)], "pad.roughness": (0.1,),
    },
    "mirror walls": {"faces": [painted("mirror", "right", "base", reflectance=0.9)]},
    "mirror walls rough 0.1": {
        "faces": [painted("mirror", "right", "base", reflectance=0.9)], "pad.roughness": (0.1,),
    },
    "mirrors all round, lit from below": {
        "lamps": [listed(-6, -3, -4, 1, 0.5, 2), listed(3, 8, -8, 0, -1, 3, 6.0)],
        "faces": [painted("mirror", "left", "tip", "right", "base", reflectance=0.95)],
    },
    "white, mirror and black walls": {
        "rows": [row("left", 2)],
        "faces": [
            painted("white", "tip", reflectance=0.9), painted("mirror", "right", reflectance=0.9),
            painted("black", "base"),
        ],
    },
    "white walls bent 45": {
        "faces": [painted("white", "right", "base", reflectance=0.8)],
        "pad.roughness": (0.1,), "bending.angles": ([45.0], DEG),
    },
    "mirror walls bent 45": {
        "faces": [painted("mirror", "right", "base", reflectance=0.9)],
        "pad.roughness": (0.1,), "bending.angles": ([45.0], DEG),
    },
    "mirror base beside a rim rough 0.1": {
        "diffuser": RIM, "pad.roughness": (0.1,),
        "faces": [painted("mirror", "base", reflectance=0.9)],
    },
    "white base beside a rim rough 0.1": {
        "diffuser": RIM, "pad.roughness": (0.1,),
        "faces": [painted("white", "base", reflectance=0.9)],
    },
    "rim on left rough 0.1": {"diffuser": rim_on("left"), "pad.roughness": (0.1,)},
    "rim on left": {"diffuser": rim_on("left")},
    "rim on left and right rough 0.1": {
        "diffuser": rim_on("left", "right"), "pad.roughness": (0.1,),
        "rows": [row("left", 1), row("tip", 2), row("base", 1)],
    },
    "rim on tip and base, painted": {
        "diffuser": rim_on("tip", "base"), "pad.roughness": (0.1,),
        "rows": [row("left", 1), row("tip", 1), row("base", 1)],
        "faces": [painted("mirror", "right", reflectance=0.9)],
    },
    "rim all round rough 0.1": {
        "diffuser": rim_on("left", "tip", "right", "base"), "pad.roughness": (0.1,),
        "rows": [row("left", 1), row("base", 2)],
    },
    "thin rim on left rough 0.1": {
        "diffuser": rim_on("left", sigma_s=(0.5, "1/mm")), "pad.roughness": (0.1,),
    },
    "rim on left and tip bent 45": {
        "diffuser": rim_on("left", "tip"), "pad.roughness": (0.1,),
        "rows": [row("left", 1), row("tip", 1), row("right", 1)],
        "bending.angles": ([45.0], DEG),
    },
    "dome": {"skin": DOME, "pad.thickness": (6.0, MM)},
    "dome rough 0.1": {"skin": DOME, "pad.thickness": (6.0, MM), "pad.roughness": (0.1,)},
    "dome, white and mirror walls": {
        "skin": DOME, "pad.thickness": (6.0, MM), "rows": [row("left", 2)],
        "faces": [
            painted("white", "tip", reflectance=0.9), painted("mirror", "right", reflectance=0.9),
        ],
    },
    "mesh": {"skin": MESH, "pad.thickness": (6.0, MM)},
    "arch": {
        "skin": ARCH | {"axis": "y"}, "pad.thickness": (6.0, MM), "fibers.height": (1.0, MM),
    },
    "arch along x rough 0.1": {
        "skin": ARCH | {"axis": "x"}, "pad.thickness": (6.0, MM), "fibers.height": (1.0, MM),
        "pad.roughness": (0.1,),
    },
    "dome lit from below": {
        "skin": DOME, "pad.thickness": (6.0, MM),
        "lamps": [listed(-6, -3, -4, 1, 0.5, 2), listed(3, 8, -8, 0, -1, 3, 6.0)],
    },
    "window": {"window": window(1.49)},
    "window rough 0.1": {"window": window(1.49), "pad.roughness": (0.1,)},
    "window lit at its edges": {"window": window(1.49), **BELOW_THE_PAD},
    "window lit at its edges rough 0.05": {
        "window": window(1.49), "pad.roughness": (0.05,), **BELOW_THE_PAD,
    },
    "window like the pad": {"window": window(1.41), **BELOW_THE_PAD},
    "window lit from below": {"window": window(1.6), "lamps": [listed(-6, -3, -7, 1, 0.5, 2)]},
    "window of low index": {"window": window(1.3), **BELOW_THE_PAD},
    "window of low index under the lamps": {"window": window(1.3)},
    "window, white, black and mirror walls": {
        "window": window(1.49), "rows": [row("left", 1, height=-1.5), row("left", 1, height=1.0)],
        "faces": [
            painted("white", "tip", reflectance=0.9), painted("mirror", "right", reflectance=0.9),
            painted("black", "base"),
        ],
    },
    "window beside a rough base": {
        "pad.index": (1.7,), "window": window(1.72, 4.0), "faces": [rough(0.3, "base")],
        "rows": [
            row("tip", 1, gap=-0.7, tilt=-7.0, profile={"sigma_v": (10.0, DEG)}, turns=False)
        ],
    },
    "window with white walls": {
        "window": window(1.49, 4.0), "faces": [painted("white", "right", "base", reflectance=0.85)],
        **BELOW_THE_PAD,
    },
    "lobe": lobe(0.1, 0.5),
    "bright lobe": lobe(0.4, 0.5),
    "sharp lobe": lobe(0.4, 0.1),
    "dim sharp lobe": lobe(0.1, 0.1),
    "lobe rough 0.1": {"pad.roughness": (0.1,), **lobe(0.4, 0.5)},
    "sharp lobe rough 0.1": {"pad.roughness": (0.1,), **lobe(0.4, 0.1)},
    "lobe behind a rim rough 0.1": {"diffuser": RIM, "pad.roughness": (0.1,), **lobe(0.4, 0.5)},
    "sharp lobe behind a rim rough 0.1": {
        "diffuser": RIM, "pad.roughness": (0.1,), **lobe(0.4, 0.1),
    },
    "sharp lobe behind a rim": {"diffuser": RIM, **lobe(0.4, 0.1)},
    "sharp lobe no face": {"pad.index": (1.0,), **lobe(0.4, 0.1)},
    "lobe, white and mirror walls": {
        "rows": [row("left", 2)], **lobe(0.4, 0.2),
        "faces": [
            painted("white", "tip", reflectance=0.9), painted("mirror", "right", reflectance=0.9),
        ],
    },
    "lobe of a dome": {"skin": DOME, "pad.thickness": (6.0, MM), **lobe(0.4, 0.2)},
    "lobe of a dome rough 0.1": {
        "skin": DOME, "pad.thickness": (6.0, MM), "pad.roughness": (0.1,), **lobe(0.4, 0.2),
    },
    "lobe over a window": {"window": window(1.49), **lobe(0.4, 0.2)},
    "lobe bent 45 rough 0.1": {
        "bending.angles": ([45.0], DEG), "pad.roughness": (0.1,), **lobe(0.4, 0.2),
    },
    "lobe bent 45 behind a rim rough 0.1": {
        "bending.angles": ([45.0], DEG), "diffuser": RIM, "pad.roughness": (0.1,), **lobe(0.4, 0.2),
    },
    "thin rim": {"diffuser": RIM | {"sigma_s": (0.2, "1/mm")}},
    "thin rim index 1.7": {"diffuser": RIM | {"sigma_s": (0.2, "1/mm")}, "pad.index": (1.7,)},
    "cast in": CAST_IN,
    "cast in rough 0.1": {"pad.roughness": (0.1,), **CAST_IN},
    "cast in no face": {"pad.index": (1.0,), **CAST_IN},
    "cast in index 1.7": {"pad.index": (1.7,), "pad.thickness": (7.7, MM), **CAST_IN},
    "cast in beside a clear rim index 1.7": {
        "pad.index": (1.7,), "diffuser": CLEAR_RIM, **CAST_IN,
    },
    "cast in beside a rim rough 0.1": {"diffuser": RIM, "pad.roughness": (0.1,), **CAST_IN},
    "cast in bent 45": {"bending.angles": ([45.0], DEG), **CAST_IN},
    "cast in bent 45 rough 0.1": {
        "bending.angles": ([45.0], DEG), "pad.roughness": (0.1,), **CAST_IN,
    },
    "cast into a rim rough 0.1": {
        "diffuser": RIM, "pad.roughness": (0.1,),
        "lamps": [listed(-11, 2, 1.5, 1, 0.2, 0.3), listed(5, 12.9, 2.2, 0.2, -1, 0, 3.0)],
    },
    "cast into a clear rim": {
        "diffuser": CLEAR_RIM, "lamps": [listed(-11, 2, 1.5, 1, 0.2, 0.3)],
    },
    "row cast in": {"rows": [row("left", 2, gap=-1.0), row("tip", 2, gap=-0.7, turns=False)]},
    "cast in between mirrors": {
        **CAST_IN,
        "faces": [painted("mirror", "left", "right", "base", "tip", reflectance=0.95)],
    },
    "cast in, black and mirror walls": {
        **CAST_IN,
        "faces": [
            painted("black", "left", "base"), painted("mirror", "right", reflectance=0.9),
        ],
    },
    "cast in over a window": {"window": window(1.49), **CAST_IN},
    "cast in over a window between mirrors": {
        "window": window(1.71), "pad.index": (1.55,), **CAST_IN,
        "faces": [painted("mirror", "left", "right", reflectance=0.95)],
    },
    "cast into a window rough 0.1": {
        "window": window(1.49), "pad.roughness": (0.1,),
        "lamps": [listed(-8, 2, -1.5, 1, 0.2, 0.5)],
    },
    "cast into a window between mirrors": {
        "window": window(1.71), "pad.index": (1.55,),
        "lamps": [listed(-8, 2, -1.5, 1, 0.2, 0.5), listed(5, -9, -1.2, -0.3, 1, 0.8, 3.0)],
        "faces": [painted("mirror", "left", "right", reflectance=0.95)],
    },
    "cast into a dome": {
        "skin": DOME, "pad.thickness": (6.0, MM), "lamps": [listed(-8, 2, 1.5, 1, 0.2, 0.3)],
    },
    "thin rim narrow": {"diffuser": RIM | {"sigma_s": (0.2, "1/mm")}, "fibers.sigma_v": (1.0, DEG)},
    "thin rim bent 45": {
        "diffuser": RIM | {"sigma_s": (0.2, "1/mm")}, "bending.angles": ([45.0], DEG),
    },
    "rim between mirrors": {
        "diffuser": rim_on("left"), "rows": [row("left", 1)],
        "faces": [painted("mirror", "right", "base", "tip", reflectance=0.95)],
    },
    "thin rim between mirrors": {
        "diffuser": rim_on("left", sigma_s=(0.5, "1/mm")), "rows": [row("left", 1)],
        "faces": [painted("mirror", "right", "base", "tip", reflectance=0.95)],
    },
}  # fmt: skip


REFUSED = (
    "cast in index 1.7", "cast in between mirrors", "cast in over a window between mirrors",
    "cast into a window between mirrors", "cast in beside a clear rim index 1.7",
    "cast into a clear rim", "window beside a rough base", "mixed 6", "mixed 18", "mixed 22",
)  # fmt: skip
"""Pads whose lamps in the silicone are seen over and over: level 2 refuses them."""
SKINS = {"dome": "dome", "arch": "arch", "mesh": "mesh"}
"""A case of each shape that a skin may have."""


def scene_of_case(case: str) -> Scene:
    """Return the scene of a case: the base with its changes.

    ``random N`` and ``mixed N`` are one of many pads (`tests.oracles.random_pads`), ``sensor N`` of
    many sensors (`tests.oracles.random_scenes`), ``shipped NAME`` is a shipped scene.
    """
    return Scene.model_validate(content_of_case(case))


def content_of_case(case: str) -> dict[str, Any]:
    """Return what the scene file of a case would hold."""
    kind, _, number = case.partition(" ")
    if kind == "shipped":
        return tomllib.loads((resources.files("render") / "scenes" / f"{number}.toml").read_text())
    if kind == "sensor":
        return dict(random_content(int(number)))
    drawn = {"random": random_case, "mixed": mixed_case}.get(kind)
    changes = CASES[case] if drawn is None else drawn(int(number))
    content: dict[str, Any] = {part: dict(values) for part, values in BASE.items()}
    for key, value in changes.items():
        part, _, name = key.partition(".")
        if name:
            content[part][name] = value
        else:
            content[part] = value
    if {"rows", "lamps"} & set(changes):
        del content["fibers"]
        content["baseline"] = {entry["edge"]: "red" for entry in changes.get("rows", ())}
        if "lamps" in changes:
            content["baseline"]["lamps"] = ["red"] * len(changes["lamps"])
    newer = {"rows", "lamps", "faces", "skin", "window", "coating.specular"} & set(changes)
    newer = newer or "on" in changes.get("diffuser", {})
    schema = {"schema": 2 if newer else 1, "name": "case"}
    return schema | dict(in_file_form(content))


def in_file_form(value: Any) -> Any:
    """Return ``value`` with each tuple of a number and a unit as a scene file has it."""
    if isinstance(value, dict):
        return {name: in_file_form(part) for name, part in value.items()}
    if isinstance(value, list):
        return [in_file_form(part) for part in value]
    if not isinstance(value, tuple):
        return value
    unit = {"unit": value[1]} if len(value) > 1 else {}
    return {"value": value[0], "source": "chosen for this test", **unit}
