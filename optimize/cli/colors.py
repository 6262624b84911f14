"""``tactilux colors``: the best light colors on somebody's transport table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument, Option

from optimize.cli.options import Json, Seed
from optimize.ui.console import ProgressBar, print_json, reserved_stdout
from render.errors import TableError

if TYPE_CHECKING:
    from optimize.scoring import TableScorer
    from optimize.search.colors import ColorResult
    from render.arrays import Array
    from render.transport import TransportTable


SHOWN = 20
"""Best colorings that programs are told."""


def run(
    path: Annotated[Path, Argument(metavar="table", help="Transport table, an .npz file.")],
    method: Annotated[
        Literal["grouped", "quick", "exact"], Option(help="Search method.")
    ] = "quick",
    phi_index: Annotated[
        int | None, Option(help="Direction node to use, where the table has several.")
    ] = None,
    scene_name: Annotated[
        str | None,
        Option("--scene", help="Scene whose LEDs and constraints hold (default: free RGB)."),
    ] = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Search the colors of a transport table."""
    from optimize.design import limits_of
    from optimize.scoring import TableScorer, score_interval
    from render.levels import level_name
    from render.scene import load_scene
    from render.transport import load_table

    with reserved_stdout() as stream:
        table = load_table(path)
        scene = load_scene(scene_name) if scene_name else None
        if scene is not None and scene.lamp_count != table.T.shape[0]:
            raise TableError(
                f"the table has {table.T.shape[0]} fibers, allowed: {scene.lamp_count} as in "
                f"scene {scene.name}; name the scene that it was made for",
                field="scene",
            )
        scorer = TableScorer(table, limits=limits_of(scene) if scene else None)
        phi = scorer.at_node(_node(table, phi_index))
        with ProgressBar(f"Colors, {method}") as bar:
            result = _search(scorer, phi, method, seed, bar)
        if as_json:
            print_json(
                stream,
                {
                    "method": result.method,
                    "colors": result.colors.tolist(),
                    "score": result.score,
                    "evaluated": result.evaluated,
                    "seconds": result.seconds,
                    "ties": [list(colors) for colors in result.ties],
                    "ties_complete": result.ties_complete,
                    "top": [
                        {"colors": list(colors), "score": score}
                        for colors, score in result.top[:SHOWN]
                    ],
                },
            )
            return
        low, high = score_interval(scorer, phi, scorer.power(result.colors))
        names = " ".join(scorer.palette.name(index) for index in result.colors)
        stream.write(
            f"{names}\nscore {result.score:.3f}, 95 % interval {low:.3f} to {high:.3f}, "
            f"{level_name(table.level, table.effort)}\n"
            f"{result.evaluated} colorings in {result.seconds:.1f} s by {result.method} search, "
            f"{len(result.ties)} other(s) tie within the table's errors"
            f"{'' if result.ties_complete else ', and perhaps more'}\n"
        )
        if result.monochrome and table.lam > 0.0:
            stream.write("One color lights everything: lam does not reward color here.\n")


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
    scorer: TableScorer, phi: Array, method: str, seed: int, bar: ProgressBar
) -> ColorResult:
    if method == "grouped":
        from optimize.search.colors import grouped_colors

        return grouped_colors(scorer, phi)
    if method == "quick":
        from optimize.search.colors import quick_colors

        return quick_colors(scorer, phi, seed=seed, progress=bar)
    from optimize.search.colors import exact_colors

    return exact_colors(scorer, phi, bar)
