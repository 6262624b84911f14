"""Runs of one color along the ring of lamps: what is wired together.

A run is all lit lamps of one color that follow each other around the rim. Lamps that are off
neither count nor split one: their place is passed by the wire, and the ring is closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optimize.design.design import DARK, Array, Colors
from optimize.design.linear_rules import LinearRules
from render.scene import Scene

KEPT = 192
"""Beginnings of a coloring that `Runs.nearest` keeps; all of them where these lead nowhere."""
ALIKE = 9
"""Digits of an angle around the rim; lamps above each other have the same."""


def around_rim(scene: Scene, images: Sequence[int | None] | None = None) -> Colors:
    """Return the numbers of the lamps ``(F,)`` in the order of their angle around the pad.

    Of lamps above each other the lowest is first. With the numbers of mirror ``images`` the ring is
    its own image: lamps that are theirs lie at its ends, or between the two halves.
    """
    places = np.array([lamp.position for lamp in scene.placed_lamps()])
    x, y, z = (places - [*(scene.box.low + scene.box.high)[:2] / 2, 0.0]).T
    if images is None:
        angle = np.round(np.arctan2(y, x), ALIKE)
        # The cut lies where the lamp of number 0 is: lamps of an untouched row stay in order.
        angle = np.round((angle - angle[0]) % (2 * np.pi), ALIKE) % round(2 * np.pi, ALIKE)
        return np.lexsort((z, angle))
    assert scene.search is not None
    across, along = (places[:, 0], y) if scene.search.mirror == "x" else (places[:, 1], x)
    angle = np.round(np.arctan2(across, -along), ALIKE)
    order = np.lexsort((z, angle))
    alone = np.array([image in (None, lamp) for lamp, image in enumerate(images)])
    half = [int(i) for i in order if not alone[i] and across[i] > 0.0]
    ends = [
        [int(i) for i in order if alone[i] and (along[i] > 0.0) == far] for far in (False, True)
    ]
    mirrored = [int(images[i] or 0) for i in reversed(half)]
    return np.array([*ends[0], *half, *ends[1], *mirrored])


def count_runs(colors: Colors) -> Colors:
    """Return the runs ``(N,)`` of ``colors`` ``(N, F)`` in the order of the ring; -1 is off.

    >>> count_runs(np.array([[0, 0, 1, -1, 1, 0], [2, -1, 2, 2, 2, 2], [-1] * 6])).tolist()
    [2, 1, 0]
    """
    lit = colors != DARK
    # Each lamp that is off takes the color of the last lit one before it, around the ring.
    twice = np.concatenate([colors, colors], axis=1)
    last = np.where(twice != DARK, np.arange(twice.shape[1]), 0)
    filled = np.take_along_axis(twice, np.maximum.accumulate(last, axis=1), axis=1)
    filled = filled[:, colors.shape[1] :]
    changes = (filled != np.roll(filled, 1, axis=1)).sum(axis=1)
    return np.where(lit.any(axis=1), np.maximum(changes, 1), 0)


@dataclass(frozen=True, eq=False)
class Runs:
    """At most ``most`` runs along ``ring`` ``(F,)``, the numbers of the lamps in their order."""

    most: int
    ring: Colors

    def fit(self, colors: Colors) -> NDArray[np.bool_]:
        """Return which of ``colors`` ``(N, F)`` have no more runs."""
        return np.asarray(count_runs(np.asarray(colors)[:, self.ring]) <= self.most)

    def nearest(
        self, value: Array, rules: LinearRules, colors: int, groups: Colors
    ) -> Colors | None:
        """Return choices ``(G,)`` of a great sum of ``value`` ``(G, choice)``; None: none fit.

        Choices from ``colors`` on are off, ``-inf`` is forbidden; ``groups`` ``(F,)`` are those of
        lamps that choose together, and `rules` are theirs. Colorings grow at both ends of the ring,
        and the `KEPT` best are kept of those that can be continued differently.
        """
        steps = _folded(groups[self.ring].tolist())
        order = [group for group, _ in steps]
        ordered = LinearRules(rules.weights[:, order], rules.most)
        for kept in (KEPT, None):
            found = self._grown(value[order], ordered, colors, [both for _, both in steps], kept)
            if found is not None:
                choices = np.empty(len(order), dtype=np.int64)
                choices[order] = found
                return choices
        return None

    def _grown(
        self,
        value: Array,
        rules: LinearRules,
        colors: int,
        at_both: Sequence[bool],
        kept: int | None,
    ) -> list[int] | None:
        # (color at the one end, at the other, changes, weight by rule): the sum, and the choices.
        State = tuple[int, int, int, tuple[int, ...]]
        states: dict[State, tuple[float, list[int]]]
        states = {(DARK, DARK, 0, (0,) * len(rules.most)): (0.0, [])}
        most = rules.most.tolist()
        # A rule about none of the lamps that follow is no more looked at.
        ends = [int(np.flatnonzero(rule.any(axis=1)).max(initial=-1)) for rule in rules.weights]
        for lamp, row in enumerate(value.tolist()):
            weights = rules.weights[:, lamp].T.tolist()
            open_ends = [lamp < end for end in ends]
            grown: dict[State, tuple[float, list[int]]] = {}
            for (first, last, changes, used), (total, chosen) in states.items():
                for choice, gain in enumerate(row):
                    if gain == -np.inf:
                        continue
                    more = [a + b for a, b in zip(used, weights[choice], strict=True)]
                    if any(a > b for a, b in zip(more, most, strict=True)):
                        continue
                    left = tuple(a * b for a, b in zip(more, open_ends, strict=True))
                    key = first, last, changes, left
                    if choice < colors:
                        changed = changes + (last not in (DARK, choice))
                        changed += at_both[lamp] and first not in (DARK, choice)
                        if changed > self.most:
                            continue
                        begun = choice if at_both[lamp] or first == DARK else first
                        key = begun, choice, changed, left
                    if key not in grown or grown[key][0] < total + gain:
                        grown[key] = total + gain, [*chosen, choice]
            best = sorted(grown.items(), key=lambda item: -item[1][0])
            states = dict(best[:kept])
        whole = [
            (total, chosen)
            for (first, last, changes, _), (total, chosen) in states.items()
            if changes + (first != last) <= self.most or first == DARK
        ]
        return max(whole)[1] if whole else None


def _folded(groups: Sequence[int]) -> list[tuple[int, bool]]:
    """Return the groups of a ring from its ends inwards, and whether each has a lamp at both.

    >>> _folded([3, 0, 1, 2, 1, 0])
    [(3, False), (0, True), (1, True), (2, False)]
    """
    first, last, found = 0, len(groups) - 1, []
    while first <= last:
        both = groups.count(groups[first]) == 2
        if both and groups[first] != groups[last]:
            raise ValueError(f"the ring {list(groups)} is not its own image")
        found.append((groups[first], both))
        first, last = first + 1, last - both
    return found
