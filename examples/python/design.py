"""What a sensor should look like under a design: design.json in, camera counts out.

Needs numpy and onnxruntime, nothing of tactilux: `python design.py design.json [MODEL_FOLDER]`.
Prints the score and, for every bend of the scene, what the camera sees of the untouched pad: what a
robot compares its first photograph with. The model does not read tactile images.

Axes: fibers are numbered around the pad, left edge from base to tip, tip edge from left to right,
right edge from tip to base, seen with the tip up. phi is 0 towards the tip on the sides and towards
+x at the tip, and 90 deg straight into the pad. Channels are red, green, blue.
"""

import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime

if len(sys.argv) < 2:
    sys.exit("usage: python design.py design.json [MODEL_FOLDER]")
folder = Path(__file__).resolve().parents[2] / "models" / "finger20"
if len(sys.argv) > 2:
    folder = Path(sys.argv[2])
try:
    file = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    design = {key: file[key] for key in ("scene", "scene_hash", "angles_deg", "power")}
    content = (folder / "checker.onnx").read_bytes()
except (OSError, ValueError, KeyError, TypeError) as error:
    sys.exit(f"{sys.argv[1]}, {error}: name a design.json and the folder of a model")

session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
about = session.get_modelmeta().custom_metadata_map
if design["scene_hash"] != about["scene_hash"]:
    sys.exit(f"the design is for {design['scene']}, the model of {about['scene']}: they must match")

bends = np.array(json.loads(about["scene_bends"]))
inputs = {
    "phi": np.radians([design["angles_deg"]]),  # (1, fiber) rad
    "power": np.array([design["power"]], dtype=float),  # (1, fiber, 3) in [0, 1]
    "bend": bends[None],  # (1, bend) rad
}
kinds = {"tensor(float)": np.float32, "tensor(double)": np.float64}
inputs = {one.name: inputs[one.name].astype(kinds[one.type]) for one in session.get_inputs()}
names = ["score", "background", "counts", "domain_excess"]
score, background, counts, excess = session.run(names, inputs)

print(f"{design['scene']}: score {score[0]:.1f} counts, domain excess {excess[0]:g}")
for bend, pad in zip(bends, background[0], strict=True):  # (site, 3)
    rows = [" ".join(f"{count:3.0f}" for count in site) for site in pad]
    print(
        f"bend {np.degrees(bend):g} deg, untouched pad by site (red green blue): {'; '.join(rows)}"
    )
facets = counts.shape[3]
print(
    f"counts of {facets} facets at {counts.shape[2]} sites are in `counts` (bend, site, facet, 3)"
)
