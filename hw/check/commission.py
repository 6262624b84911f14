"""How a rig looked when it was healthy: measured over predicted light, kept in a file.

The model's own error is the same at every start, so it cancels against such a record; faults that
are small beside that error, a fiber turned by 10 deg above all, show only then.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hw.camera.led_colors import own_channels
from hw.check.camera_response import channel_gains, measured_response
from hw.check.prediction import PadPrediction
from hw.errors import CaptureError
from render.arrays import Array
from render.files import read_npz, write_npz
from tactilux import Scene

SCHEMA = 3
HEALTHY_RATIO = (0.2, 5.0)
"""Range of measured over predicted light of a fiber in a rig that can be called healthy."""

MIN_SEEN = 0.02
"""Light of a channel over the fiber's brightest from which a record by channel holds it."""


@dataclass(frozen=True, eq=False)
class RigRecord:
    """A healthy rig.

    Arguments:
        ratio: ``(fiber, site)`` measured over predicted light; 1 for fibers without power. With one
            more axis ``channel`` where light depends on it, as the model's error does then; in
            channels that hardly see a fiber, the mean of those in which it shines.
        phi, power: ``(fiber,)`` rad and ``(fiber, color)``, the design that was captured.
        scene_hash: the scene of the design.
        bend: rad, of the capture, or the number of the state of its skin.
        starts: of the rig that are averaged.
        response: ``(color, channel)``, what each channel sees of each LED color.
    """

    ratio: Array
    phi: Array
    power: Array
    scene_hash: str
    bend: float
    starts: int = 1
    response: Array = field(default_factory=lambda: np.eye(3))

    def joined(self, other: RigRecord) -> RigRecord:
        """Return the record of the starts of both, which must be of the same rig."""
        starts = self.starts + other.starts
        mean = (self.starts * np.log(self.ratio) + other.starts * np.log(other.ratio)) / starts
        response = (self.starts * self.response + other.starts * other.response) / starts
        return replace(self, ratio=np.exp(mean), starts=starts, response=response)

    def save(self, path: Path) -> None:
        """Write the record, atomically."""
        arrays = {name: np.asarray(value) for name, value in vars(self).items()}
        write_npz(path, arrays | {"schema": np.array(SCHEMA)})

    def check_fits(self, prediction: PadPrediction, scene: Scene, bend: float) -> None:
        """Refuse a record of another design, scene, bend or state.

        ``bend`` is rad, or the number of a state of ``scene``.

        Raises:
            CaptureError: says what differs.
        """
        if self.ratio.shape[:2] != prediction.cells or self.scene_hash != scene.hash:
            what = "another scene"
        elif self.ratio.ndim != prediction.table.ndim - 1:
            what = "one light in all channels, where the skin's albedo makes it differ by channel"
        elif not np.allclose(self.phi, prediction.phi, atol=1e-4) or not np.allclose(
            self.power, prediction.power, atol=1e-4
        ):
            what = "another design"
        elif abs(self.bend - bend) > np.radians(0.5):
            what = f"a bend of {np.degrees(self.bend):g} deg"
            if scene.states is not None:
                names = dict(zip(scene.state_axis, scene.state_names, strict=True))
                what = f"the state {names.get(self.bend, f'{self.bend:g}')}"
        else:
            return
        raise CaptureError(
            f"the rig's record was made for {what}: make a new one with --commission", field="rig"
        )


def load_record(path: Path) -> RigRecord:
    """Return the record in ``path``.

    Raises:
        TableError: no readable file; CaptureError: something else than a rig's record.
    """
    arrays = read_npz(path)
    try:
        schema, bend, starts = (arrays.pop(name).item() for name in ("schema", "bend", "starts"))
        scene_hash = str(arrays.pop("scene_hash"))
        record = RigRecord(**arrays, scene_hash=scene_hash, bend=bend, starts=starts)
        fibers, numbers = (
            len(record.phi),
            (record.ratio, record.phi, record.power, record.bend, record.response),
        )
        good = schema == SCHEMA and starts > 0
        colors, channels = record.response.shape
        good &= record.ratio.shape[2:] in ((), (channels,)) and record.ratio.shape[0] == fibers
        good &= record.ratio.ndim >= 2
        good &= record.phi.shape == (fibers,) and record.power.shape == (fibers, colors)
        good &= all(np.isfinite(part).all() for part in numbers) and (record.ratio > 0).all()
    except (KeyError, TypeError, ValueError):
        good = False
    if not good:
        raise CaptureError(
            f"{path} is not the record of a rig: make one with `tactilux check --commission`",
            field="rig",
        )
    return record


def commission(prediction: PadPrediction, colors: Array, scene: Scene, bend: float) -> RigRecord:
    """Return the record of a rig that is known to be healthy.

    ``colors`` ``(fiber, site, channel)`` are counts of each fiber alone; ``bend`` is rad, or the
    number of a state of ``scene``.

    Raises:
        CaptureError: some fiber is so far from the prediction that the rig cannot be healthy.
    """
    response = measured_response(prediction, colors, recorded=True)
    prediction = replace(prediction, response=response)
    expected = prediction.alone
    lit = prediction.lit
    weight = prediction.power @ own_channels(response)
    weight = weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-9)
    wanted = np.einsum("fsc,fc->fs", expected, weight)
    # The white balance of a channel is no fault of its fibers.
    own, one_led = prediction.own, prediction.one_led
    balance = channel_gains(expected, colors, own, one_led=one_led)
    balanced = np.einsum("fsc,fc->fs", colors / balance, weight)
    overall = balanced.sum(axis=1) / np.where(lit, wanted.sum(axis=1), 1.0)
    bad = lit & ~((overall > HEALTHY_RATIO[0]) & (overall < HEALTHY_RATIO[1]))
    if bad.any():
        fiber = int(np.argmax(bad))
        raise CaptureError(
            f"fiber {fiber} gives {overall[fiber]:.2f} times the predicted light, allowed: "
            f"{HEALTHY_RATIO[0]:g} to {HEALTHY_RATIO[1]:g}; mend the rig before its record is made",
            field="colors",
        )
    # But the record holds it where a fiber is alone in its channel: see `channel_gains`.
    gain = channel_gains(expected, colors, own, recorded=True, one_led=one_led)
    seen = np.einsum("fsc,fc->fs", colors / gain, weight)
    ratio = _ratio(seen, wanted, lit)
    if prediction.table.ndim == 4:
        whole = expected.sum(axis=1)
        bright = whole > MIN_SEEN * np.maximum(whole.max(axis=1, keepdims=True), 1e-9)
        each = [
            _ratio(colors[..., c] / gain[c], expected[..., c], bright[:, c])
            for c in range(len(gain))
        ]
        ratio = np.where(bright[:, None], np.stack(each, axis=-1), ratio[..., None])
    return RigRecord(
        ratio, prediction.phi, prediction.power, scene.hash, bend, response=prediction.response
    )


def _ratio(seen: Array, wanted: Array, lit: NDArray[np.bool_]) -> Array:
    """Return seen over wanted light ``(fiber, site)``, 1 where a fiber is not ``lit``."""
    ratio = np.where(lit[:, None], seen / np.where(lit[:, None], wanted, 1.0), 1.0)
    # A site too dark to be measured says nothing; it keeps its fiber's ratio.
    whole = seen.sum(axis=1) / np.where(lit, wanted.sum(axis=1), 1.0)
    return np.maximum(ratio, 0.2 * np.where(lit, whole, 1.0)[:, None])
