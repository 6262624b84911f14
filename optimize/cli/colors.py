"""``tactilux colors``: the best light colours on somebody's transport table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from optimize.design.design import Array, colour_name
from optimize.scoring.evaluate import TableScorer
from optimize.ui.console import Meter, print_json, reserved_stdout
from render.errors import TableError
from render.transport import TransportTable, load_table

if TYPE_CHECKING:
    from optimize.search.colors.result import ColourResult


SHOWN = 20
"""Best colourings that programs are told."""


def run(
    path: Path,
    *,
    method: str,
    phi_index: int | None,
    seed: int,
    device: str | None,
    as_json: bool,
) -> None:
    """Search colours on the table in ``path`` at one direction node and print the best."""
    if device is not None and method != "exact":
        raise TableError(
            f"--device is for the method exact, not {method}: leave it out", field="device"
        )
    with reserved_stdout() as stream:
        table = load_table(path)
        scorer = TableScorer(table)
        phi = scorer.at_node(_node(table, phi_index))
        with Meter(f"Colours, {method}") as meter:
            result = _search(scorer, phi, method, seed, device, meter)
        if as_json:
            print_json(
                stream,
                {
                    "method": result.method,
                    "colors": result.colours.tolist(),
                    "score": result.score,
                    "evaluated": result.evaluated,
                    "seconds": result.seconds,
                    "ties": [list(colours) for colours in result.ties],
                    "ties_complete": result.ties_complete,
                    "top": [
                        {"colors": list(colours), "score": score}
                        for colours, score in result.top[:SHOWN]
                    ],
                },
            )
            return
        low, high = scorer.rating(phi, scorer.power(result.colours)).interval
        names = " ".join(colour_name(index) for index in result.colours)
        stream.write(
            f"{names}\nscore {result.score:.3f}, 95 % interval {low:.3f} to {high:.3f}, "
            f"level {table.level}\n{result.evaluated} colourings in {result.seconds:.1f} s by "
            f"{result.method} search, {len(result.ties)} other(s) tie within the table's errors"
            f"{'' if result.ties_complete else ', and perhaps more'}\n"
        )
        if result.monochrome:
            stream.write("One colour lights everything: lam does not reward colour here.\n")


def _node(table: TransportTable, phi_index: int | None) -> int:
    nodes = len(table.phi)
    if phi_index is None and nodes > 1:
        raise TableError(
            f"the table has {nodes} direction nodes, so one must be chosen: "
            f"give --phi-index, 0 to {nodes - 1}",
            field="phi_index",
        )
    return phi_index or 0


def _search(
    scorer: TableScorer, phi: Array, method: str, seed: int, device: str | None, meter: Meter
) -> ColourResult:
    if method == "grouped":
        from optimize.search.colors.grouped import grouped_colours

        return grouped_colours(scorer, phi)
    if method == "quick":
        from optimize.search.colors.quick import quick_colours

        return quick_colours(scorer, phi, seed=seed, progress=meter)
    from optimize.search.colors.exact import exact_colours

    return exact_colours(
        scorer, phi, lambda at: meter(at.done, at.total, at.eta_seconds), device=device
    )
