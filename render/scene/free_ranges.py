"""What of the diffuser is not fixed yet: ranges that a surrogate is trained for as a whole.

An optional section of the scene file. The scene itself keeps its values (they lie in the ranges),
so the section has no part in the scene's hash; a model that was trained with it takes the free
quantities as an input and serves every scene that differs in them alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from render.scene.quantities import Part, Quantity

Scattering = Annotated[tuple[float, ...], Quantity("1/mm", 0.01, 50.0, many=True)]
Thickness = Annotated[tuple[float, ...], Quantity("mm", 0.1, 20.0, many=True)]
UNITS = {"reduced_scattering": "1/mm", "diffuser_thickness": "mm"}


class FreeRanges(Part):
    """Lowest and highest value of each free quantity of the diffuser.

    ``reduced_scattering`` is sigma_s (1 - g) in 1/mm at the scene's g; ``diffuser_thickness`` in
    mm.
    """

    reduced_scattering: Scattering | None = None
    diffuser_thickness: Thickness | None = None

    def ranges(self) -> dict[str, tuple[float, ...]]:
        """Return the ranges that are named."""
        named = {name: getattr(self, name) for name in UNITS}
        return {name: values for name, values in named.items() if values is not None}

    def problems(self, values: dict[str, float]) -> Iterator[str]:
        """Yield what does not fit the scene's own ``values``, one sentence each."""
        if not self.ranges():
            yield "free names nothing, allowed: " + " or ".join(UNITS)
        for name, given in self.ranges().items():
            shown = ", ".join(f"{value:g}" for value in given)
            if len(given) != 2 or not given[0] < given[1]:
                yield f"free.{name} = {shown} {UNITS[name]}, allowed: two values, ascending"
            elif name not in values:
                yield f"free.{name}: the scene has no diffuser, leave it out"
            elif not given[0] <= values[name] <= given[1]:
                yield (
                    f"free.{name} = {shown} {UNITS[name]}, allowed: a range around the scene's own "
                    f"{values[name]:g} {UNITS[name]}"
                )

    def sentences(self) -> Iterator[str]:
        """Yield the ranges in words."""
        for name, (low, high) in self.ranges().items():
            yield f"{name}: {low:g} to {high:g} {UNITS[name]}"
