"""What a check says about a rig."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum

from hw.check.bands import Bands


class FiberState(StrEnum):
    """What is the matter with a fiber."""

    OK = "ok"
    OFF = "off"  # the design leaves it dark, so nothing can be said
    DEAD = "dead"
    DIM = "dim"
    SWAPPED = "swapped"
    MOVED = "moved"
    UNCLEAR = "unclear"


WORDS = {
    FiberState.OK: "is as designed",
    FiberState.OFF: "is not lit by the design",
    FiberState.DEAD: "is dead: check its LED, its cable and the fiber's end",
    FiberState.DIM: "is dim: check its LED, its coupling and the fiber for a break",
    FiberState.SWAPPED: "has the wrong color: check the wiring of its LED",
    FiberState.MOVED: "points elsewhere: check its seat",
    FiberState.UNCLEAR: "differs in a way that no single fault explains: clean the pad and the "
    "lens",
}
"""What follows the name of a fiber."""


@dataclass(frozen=True)
class FiberDiagnosis:
    """What is known about one fiber.

    Arguments:
        index: number of the fiber.
        state: the most probable state.
        confidence: its probability, in [0, 1], under the tolerances of the check.
        power: measured power relative to the others', 1 when as designed; None where unknown.
        turned: measured turn in rad, positive towards larger phi; None where unknown.
        detail: more about the state, for people.
    """

    index: int
    state: FiberState
    confidence: float
    power: float | None = None
    turned: float | None = None
    detail: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """What a check found.

    Arguments:
        fibers: one entry per fiber.
        score: the design's predicted score, in counts.
        counts_error: root mean square difference between captured and predicted colors after
            matching the camera's gains, in counts.
        domain_excess: 0 inside the model's trained range.
        bands: of LEDs that dim by pulses, in its photographs.
    """

    fibers: tuple[FiberDiagnosis, ...]
    score: float
    counts_error: float
    domain_excess: float
    bands: tuple[Bands, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether every fiber that is lit is as designed."""
        return not self.faults

    @property
    def faults(self) -> list[FiberDiagnosis]:
        """The fibers that are not as designed."""
        healthy = (FiberState.OK, FiberState.OFF)
        return [fiber for fiber in self.fibers if fiber.state not in healthy]

    @property
    def unlit(self) -> str:
        """The sentence that names the fibers which the design leaves dark; "" where it lights all.

        >>> dark = FiberDiagnosis(3, FiberState.OFF, 1.0)
        >>> Diagnosis((dark,), 0.0, 0.0, 0.0).unlit
        'Fiber 3 is not lit by the design.'
        """
        dark = [str(fiber.index) for fiber in self.fibers if fiber.state is FiberState.OFF]
        if len(dark) > 1:
            return f"Fibers {', '.join(dark)} are not lit by the design."
        return f"Fiber {dark[0]} {WORDS[FiberState.OFF]}." if dark else ""

    def to_json(self) -> dict[str, object]:
        """Return what programs rely on."""
        return {
            "ok": self.ok,
            "score": self.score,
            "counts_error": self.counts_error,
            "fibers": [
                {"index": one.index, "state": one.state.value, "confidence": one.confidence}
                for one in self.fibers
            ],
            "domain_excess": self.domain_excess,
            "bands": [asdict(one) for one in self.bands],
        }
