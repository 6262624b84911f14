"""What the closed forms of both readers share: degrees at each design's own exposure."""

from __future__ import annotations

from abc import ABC, abstractmethod

from optimize.design import Array
from optimize.readers.camera_model import FULL_SCALE, CameraModel
from render.scene import Scene


class ExpectedError(ABC):
    """A reader's expected error on one scene, in degrees, smooth in the colors."""

    camera: CameraModel

    @abstractmethod
    def __init__(self, scene: Scene, camera: CameraModel) -> None:
        """Lay out the normals that are read, the same for every design."""

    @abstractmethod
    def exposed_degrees(self, colors: Array, gain: Array) -> Array:
        """Return the errors ``(N,)`` of ``colors`` ``(N, B, S, facet + 1, C)`` and ``gain`` (N,).

        ``colors`` are exposed counts of facets and untouched pad, not clipped.
        """

    @abstractmethod
    def exposed_slopes(self, colors: Array, gain: Array) -> tuple[Array, Array, Array]:
        """Return `exposed_degrees` and derivatives by ``colors``, of its shape, and ``gain``."""

    def degrees(self, counts: Array) -> Array:
        """Return the errors ``(N,)`` of ``counts`` ``(N, B, S, facet + 1, C)``.

        They are counts at the scene's exposure, not clipped; each design takes its own.
        """
        factor, gain, _ = self.camera.exposed(counts.reshape(len(counts), -1))
        return self.exposed_degrees(counts * factor[:, None, None, None, None], gain)

    def slopes(self, counts: Array) -> tuple[float, Array]:
        """Return the error of one design and its derivatives, of the shape of ``counts``."""
        factor, gain, decides = self.camera.exposed(counts.reshape(1, -1))
        degrees, by_exposed, by_gain = self.exposed_slopes(factor[0] * counts[None], gain)
        by_factor = float((by_exposed[0] * counts).sum())
        longest, shots = self.camera.longest_exposure, self.camera.shots
        if gain[0] > shots * (1.0 + 1e-12) and not self.camera.gains:
            by_factor += float(by_gain[0]) * shots / longest
        by_counts = factor[0] * by_exposed[0]
        # The exposure is 255 over the count that decides it, unless the camera cannot reach it.
        brightest = counts.flat[decides[0]]
        reached = factor[0] * brightest > (1.0 - 1e-9) * FULL_SCALE
        if brightest > 0.0 and (reached or FULL_SCALE / brightest < longest):
            by_counts.flat[decides[0]] -= by_factor * factor[0] / brightest
        return float(degrees[0]), by_counts
