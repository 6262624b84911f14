"""A scene that is freed while a kernel is traced, in processes that this could end."""

from __future__ import annotations

import subprocess
import sys

import pytest

START = """
import gc, sys
from render.reference.llvm import mitsuba
from render.steady_registry import steady_registry
mi = mitsuba("llvm_ad_rgb")
import drjit as dr
gc.disable()

def scene():
    film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    turned = mi.ScalarTransform4f().rotate([0, 1, 0], 180)
    sensor = {"type": "perspective", "film": film, "to_world": turned}
    there = mi.ScalarTransform4f().translate([0, 0, -2])
    lamp = {"type": "rectangle", "to_world": there, "emitter": {"type": "area"}}
    return mi.load_dict({"type": "scene", "sensor": sensor, "lamp": lamp})

older = [scene()]
older.append(older)
del older  # a cycle holds the scene until the collector comes
here = scene()
"""
TRACED = """
with steady_registry():
    rays = mi.Ray3f(mi.Point3f(0, 0, 0), mi.Vector3f(dr.linspace(mi.Float, -0.2, 0.2, 8), 0, -1))
    before = here.ray_intersect(rays).t
    gc.collect()
    after = here.ray_intersect(rays).t
    dr.eval(before, after)
print(bool((before.numpy() == after.numpy()).all()))
"""
RENDERED = """
calls = 0
def entered(frame, event, _):
    global calls
    if event == "call" and frame.f_code.co_name == "trace_segment":
        calls += 1
        gc.collect()
sys.setprofile(entered)
mi.render(here, integrator=mi.load_dict({"type": "bdpt"}), spp=4)
print(calls > 0)
"""


def printed(code: str) -> str:
    """Return what a Python process prints, or how it ended."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else done.stderr[-2000:]


def test_a_kernel_compiles_though_garbage_is_collected_while_it_is_traced() -> None:
    assert printed(START + TRACED) == "True"


@pytest.mark.slow
def test_a_picture_is_rendered_though_garbage_is_collected_while_it_is_traced() -> None:
    assert printed(START + RENDERED) == "True"


def test_older_scenes_are_freed_after_the_tracing() -> None:
    first = "gc.collect(); print(dr.reinterpret_array(mi.ShapePtr, mi.UInt32(1))[0])"
    assert printed(START + TRACED + first) == "True\nNone"
