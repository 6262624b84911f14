"""What is compiled for a picture: few kernels, and none anew for other numbers or seeds."""

from __future__ import annotations

import subprocess
import sys
from types import ModuleType
from typing import Any

import drjit as dr
import pytest

SIZE = 16
KERNELS_MAX, LINES_MAX = 7, 2.35
"""Of ``bdpt`` on a box of diffuse walls, the second relative to ``path``: LLVM takes about as long
as there are lines of its code, functions included. 28 kernels when each kind of subpath had its
own, and 2.5 times the lines when records were written by fours."""


def box(mono: ModuleType) -> Any:
    content = mono.cornell_box()
    content["sensor"]["film"] |= {"width": SIZE, "height": SIZE}
    return mono.load_dict(content)


def compiled(mono: ModuleType, scene: Any, spp: int = 4, **integrator: Any) -> dict[Any, int]:
    """Return the lines of code of each kernel that a picture launches, by its hash."""
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        mono.render(scene, integrator=mono.load_dict(integrator), spp=spp)
        history = dr.kernel_history([dr.KernelType.JIT])
    return {kernel["hash"]: kernel["ir"].getvalue().count("\n") for kernel in history}


def alone(code: str) -> str:
    """Return what ``code`` prints in a process of its own.

    Dr.Jit compiles the methods of all instances that are alive.
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


BOX = """
from render.reference.llvm import mitsuba
from tests.render.integrators.test_kernels import box, compiled
mi = mitsuba("llvm_ad_mono")
of_path, ours = (compiled(mi, box(mi), type=kind) for kind in ("path", "bdpt"))
print()
print(len(ours), sum(ours.values()), sum(of_path.values()))
"""


@pytest.mark.slow
def test_a_picture_of_diffuse_walls_takes_few_kernels_and_lines() -> None:
    kernels, lines, of_path = map(int, alone(BOX).split()[-3:])
    assert kernels <= KERNELS_MAX
    assert lines <= LINES_MAX * of_path


POINT = """
from render.reference.llvm import mitsuba
from tests.render.integrators.test_bidirectional import image, plane
mi = mitsuba("llvm_ad_mono")
assert not image(mi, plane(mi), 16, type="bdpt", max_depth=1).any()
"""


@pytest.mark.slow
def test_subpaths_that_begin_with_the_same_literals_are_compiled() -> None:
    """With a single point light both kinds do; a branch of Dr.Jit's would be no valid code."""
    alone(POINT)


@pytest.mark.slow
def test_other_numbers_of_samples_compile_nothing_of_size(mono: ModuleType) -> None:
    scene = box(mono)
    before = compiled(mono, scene, type="bdpt")
    after = compiled(mono, scene, spp=9, type="bdpt", replicates=5)
    assert max((n for hashed, n in after.items() if hashed not in before), default=0) < 100


@pytest.mark.slow
def test_the_bootstrap_and_the_chains_launch_the_same_kernels(mono: ModuleType) -> None:
    few = {"type": "pssmlt", "chains": 256, "luminance_samples": 2048, "chains_only": True}
    large = [n for n in compiled(mono, box(mono), **few).values() if n > 1000]
    # Two of the plain samples, which share light vertices, and two of all that chains do.
    assert len(large) == 4
