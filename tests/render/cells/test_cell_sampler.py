"""What the cell sampler compiles: kernels know what a sensor is made of, not its numbers.

Compiling takes 5 to 20 s, rendering 96 samples of every cell one or two. So sensors that differ in
their numbers alone share kernels, pressed and untouched pads do, and so do one design and eight.
"""

from __future__ import annotations

import json
import subprocess
import sys
from types import ModuleType

import numpy as np
import pytest

from render.scene import load_scene

# Dr.Jit remembers what a process has compiled, so kernels are told apart in one of their own.
RENDER = """
import json, re
import drjit as dr
import numpy as np
from render.reference import render_transport
from render.scene import load_scene

dr.set_flag(dr.JitFlag.KernelHistory, True)
NUMBER = r"insertelement <\\d+ x \\w+> undef, (\\w+ [-.\\w]+),"  # a literal, for all lanes
base = load_scene("finger20")
wide = base.pad.model_copy(update={"width": 15.0, "thickness": 3.5, "index": 1.5, "roughness": 0.2})
milk = base.diffuser.model_copy(
    update={"thickness": 2.5, "sigma_s": 3.0, "sigma_a": 0.01, "g": 0.5}
)
view = base.camera.model_copy(update={"distance": 12.0, "columns": 300, "rows": 400})
sites = base.sites.model_copy(update={"columns": 2, "rows": 3, "spacing": 2.5})
parts = {"pad": wide, "diffuser": milk, "camera": view, "sites": sites}
other = base.model_copy(update=parts)
clear = base.model_copy(update={"diffuser": None})
few = clear.model_copy(update={"pad": wide, "camera": view, "sites": sites})


def kernels(scene, nodes, bend):
    dr.kernel_history_clear()
    phi = np.tile(np.linspace(1.0, 2.0, nodes), (scene.lamp_count, 1))
    render_transport(scene, phi, np.array([bend]), samples=8, seeds=(1,))
    found = [k for k in dr.kernel_history() if k.get("operation_count", 0) > 1000]
    numbers = [sorted(re.findall(NUMBER, k["ir"].read())) for k in found]
    return sorted({json.dumps([k["operation_count"], n]) for k, n in zip(found, numbers)})


pairs = {
    "milky": [kernels(base, 4, 0.0), kernels(other, 4, 0.0)],
    "bent": [kernels(base, 4, 0.5), kernels(other, 4, 1.0)],
    "clear": [kernels(clear, 4, 0.0), kernels(few, 4, 0.0)],
    "designs": [kernels(base, 1, 0.0), kernels(base, 5, 0.0)],
}
print(json.dumps(pairs))
"""


@pytest.fixture(scope="module")
def compiled() -> dict[str, list[list[str]]]:
    """Return the kernels of pairs of renders, of finger20 and of pads with other numbers.

    They are told apart by their operations and literals: Dr.Jit (1.5) may order operands in one of
    two ways, and then compiles both once.
    """
    done = subprocess.run(
        [sys.executable, "-c", RENDER], capture_output=True, text=True, check=True
    )
    return dict(json.loads(done.stdout))


@pytest.mark.slow
@pytest.mark.parametrize("pair", ["milky", "bent", "clear", "designs"])
def test_other_numbers_take_no_other_kernels(
    compiled: dict[str, list[list[str]]], pair: str
) -> None:
    one, other = compiled[pair]
    assert all(json.loads(kernel)[1] for kernel in one)
    assert one == other


def test_nodes_that_fill_up_leave_each_its_part_of_the_strata(mono: ModuleType) -> None:
    """The light subpaths of a lane divide the nodes among themselves, in order."""
    from render.cells.cell_sampler import filled_up

    strata = (np.arange(64) + 0.5) / 64
    for nodes in (1, 2, 4, 8):
        node = filled_up(load_scene("finger20"), nodes)
        drawn = node[(strata * len(node)).astype(int)]
        np.testing.assert_array_equal(drawn, (strata * nodes).astype(int))
    assert np.bincount(filled_up(load_scene("finger20"), 11)).min() >= 1
    assert len(filled_up(load_scene("digit"), 1)) == 1
