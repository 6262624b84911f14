"""Run checker.onnx on its golden input and print what comes out.

Needs numpy and onnxruntime, nothing of tactilux: `python golden.py [MODEL_FOLDER]`.
"""

import hashlib
import io
import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime

INPUTS = ("phi", "power", "bend")
OUTPUTS = ("counts", "counts_spread", "background", "metric", "score", "domain_excess")

default = Path(__file__).resolve().parents[2] / "models" / "finger20"
folder = Path(sys.argv[1]) if len(sys.argv) > 1 else default


def read(name: str) -> bytes:
    """Return the content of a file of the model."""
    try:
        return (folder / name).read_bytes()
    except OSError as error:
        sys.exit(f"{folder / name} cannot be read ({error.strerror}): name a model's folder")


# An altered model gives plausible numbers: compare checksums before it is trusted.
sums = dict(reversed(line.split()) for line in read("checker.sha256").decode().splitlines())
content = {name: read(name) for name in ("checker.onnx", "golden.npz")}
for name, file in content.items():
    if hashlib.sha256(file).hexdigest() != sums.get(name):
        sys.exit(f"{folder / name} was altered: take a fresh copy of the model")

session = onnxruntime.InferenceSession(content["checker.onnx"], providers=["CPUExecutionProvider"])
about = session.get_modelmeta().custom_metadata_map
golden = np.load(io.BytesIO(content["golden.npz"]), allow_pickle=False)
# phi (batch, fibers) and bend (batch, bends) in rad, power (batch, fibers, 3) in [0, 1].
found = dict(
    zip(OUTPUTS, session.run(OUTPUTS, {name: golden[name] for name in INPUTS}), strict=True)
)

print(f"{about['scene']}, scene {about['scene_hash']}, units {json.loads(about['units'])['score']}")
reach = json.loads(about["conformal"])["score"]
for design, (score, excess) in enumerate(zip(found["score"], found["domain_excess"], strict=True)):
    red, green, blue = found["counts"][design, 0, 0, 0]
    print(
        f"design {design}: score {score:.3f} ± {reach:.2f}, domain excess {excess:g}, "
        f"first facet {red:.2f} {green:.2f} {blue:.2f}"
    )

worst = max(float(np.abs(found[name] - golden[name]).max()) for name in OUTPUTS)
print(f"largest difference from the golden output: {worst:.2g}")
sys.exit(0 if worst < 0.01 else "this runtime computes something else")
