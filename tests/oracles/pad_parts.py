"""What pads are made of, as scene files have it but for tuples of a number and its unit."""

from __future__ import annotations

from typing import Any

from tests.oracles.skin_bodies import sphere_file

MM, DEG = "mm", "deg"
BASE: dict[str, dict[str, Any]] = {
    "pad": {"width": (20.0, MM), "length": (24.0, MM), "thickness": (4.5, MM), "index": (1.41,),
            "roughness": (0.0,)},
    "coating": {"albedo": (0.5,)},
    "fibers": {"left": 1, "tip": 1, "right": 0, "diameter": (1.0, MM), "gap": (0.6, MM),
               "height": (2.0, MM), "sigma_v": (30.0, DEG), "tilt": (10.0, DEG)},
    "camera": {"distance": (20.0, MM), "y": (0.0, MM), "field_of_view": (65.0, DEG),
               "columns": 320, "rows": 400},
    "bending": {"angles": ([0.0], DEG)},
    "sites": {"columns": 3, "rows": 2, "spacing": (5.0, MM), "centre_x": (0.0, MM),
              "centre_y": (1.0, MM)},
    "indenter": {"faces": 6, "slope": (30.0, DEG), "radius": (0.8, MM)},
    "baseline": {"left": "red", "tip": "green", "right": "blue"},
}  # fmt: skip
RIM = {"thickness": (2.0, MM), "sigma_s": (4.0, "1/mm"), "sigma_a": (0.005, "1/mm"), "g": (0.75,)}
CLEAR_RIM = RIM | {"sigma_s": (0.0, "1/mm"), "sigma_a": (0.0, "1/mm")}

DOME: Any = {"shape": "dome", "radius": (30.0, MM)}
ARCH: Any = {"shape": "arch", "radius": (20.0, MM)}
MESH: Any = {"shape": "mesh", "mesh": {"file": str(sphere_file()), "source": "a sphere"}}

LAMBERTIAN: Any = "lambertian"
GAUSSIAN: Any = {"sigma_v": (20.0, DEG)}
COSINE_8: Any = {"cosine_exponent": (8.0,)}


def row(edge: str, count: int, **changes: Any) -> dict[str, Any]:
    """Return a row of Lambertian lamps with its ``changes``, mm and deg."""
    values = {"diameter": 1.0, "gap": 0.6, "height": 2.0, "tilt": 10.0} | changes
    units = {"diameter": MM, "gap": MM, "height": MM, "tilt": DEG}
    lengths = {name: (values.pop(name), unit) for name, unit in units.items()}
    return {"edge": edge, "count": count, "profile": LAMBERTIAN} | lengths | values


def rough(alpha: float, *faces: str) -> dict[str, Any]:
    """Return the entry of faces of their own roughness."""
    return {"on": list(faces), "roughness": (alpha,)}


def painted(kind: str, *faces: str, reflectance: float = 0.0) -> dict[str, Any]:
    """Return the entry of faces that are ``black``, ``white`` or a ``mirror``."""
    return {"on": list(faces), kind: True if kind == "black" else (reflectance,)}


def rim_on(*edges: str, **changes: Any) -> dict[str, Any]:
    """Return a diffuser on some edges alone."""
    return RIM | {"on": list(edges)} | changes


def listed(x: float, y: float, z: float, *beam: float) -> dict[str, Any]:
    """Return a lamp 1.5 mm wide; a fourth number of its ``beam`` is the power of its cosine."""
    profile = {"cosine_exponent": (beam[3],)} if len(beam) > 3 else LAMBERTIAN
    return {
        "position": ([float(x), float(y), float(z)], MM),
        "direction": (list(map(float, beam[:3])),),
        "diameter": (1.5, MM),
        "profile": profile,
    }


def window(index: float, thickness: float = 3.0) -> dict[str, Any]:
    """Return a plate under the pad."""
    return {"thickness": (thickness, MM), "index": (index,)}


def lobe(specular: float, roughness: float) -> dict[str, Any]:
    """Return the entries of a skin's lobe."""
    return {"coating.specular": (specular,), "coating.roughness": (roughness,)}


BELOW_THE_PAD = {"rows": [row("left", 1, height=-1.5), row("tip", 2, height=-2.0, tilt=30.0)]}
"""Lamps before the edges of a window 3 mm thick."""

CAST_IN = {
    "lamps": [listed(-8, 2, 1.5, 1, 0.2, 0.3), listed(5, -9, 0.8, -0.3, 1, 0.8, 3.0)],
}
"""Lamps in the silicone, near two edges."""
