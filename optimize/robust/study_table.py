"""Tables of a study for the terminal: robust ratings, shadows and sensitivities."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import IO

from optimize.robust.sensitivity import Sensitivity
from optimize.robust.study import Study

UNITS = {"fiber_angle": ("deg", 180.0 / math.pi), "diffuser_thickness": ("mm", 1.0)}


def print_study(stream: IO[str], found: Study, titles: Mapping[str, str]) -> None:
    """Write the tables to ``stream``; ``titles`` names the stages by key."""
    from rich.console import Console
    from rich.table import Table

    console = Console(file=stream, width=None if stream.isatty() else 100)
    if found.robust:
        draws = next(iter(found.robust.values())).draws
        table = Table(title=f"On {draws} sensors as built", title_justify="left")
        table.add_column("design")
        for heading in ("S as drawn", "mean S", "deviation", "lower 10 %", "95% interval of it"):
            table.add_column(heading, justify="right")
        for key, rating in found.robust.items():
            low, high = rating.low_interval
            table.add_row(
                titles[key],
                f"{rating.nominal:.1f}",
                f"{rating.mean:.1f}",
                f"{rating.deviation:.1f}",
                f"{rating.low:.1f}",
                f"{low:.1f} to {high:.1f}",
            )
        console.print(table)
    if found.sensitivities:
        print_sensitivities(stream, found.sensitivities)
    if found.at_end:
        stream.write(
            f"{found.at_end:.1%} of the turned fibers would leave 0 to 180 deg and stay there.\n"
        )
    for key, penalty in found.shadows.items():
        stream.write(f"{titles[key]}: a bolt's shadows take {penalty:.1f} counts.\n")


def print_sensitivities(stream: IO[str], entries: tuple[Sensitivity, ...]) -> None:
    """Write the sensitivity table, the dearest tolerance first."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title="What each tolerance alone costs, in counts", title_justify="left")
    table.add_column("tolerance", no_wrap=True)
    headings = ("sigma", "slope of S", "spread of S", "mean loss", "loss at low 10 %")
    for heading in (*headings, "fiber"):
        table.add_column(heading, justify="right")
    for entry in entries:
        unit, factor = UNITS.get(entry.name, ("%", 100.0))
        steepest = entry.slope[abs(entry.slope).argmax()] / factor
        table.add_row(
            entry.name,
            f"{entry.sigma * factor:.3g} {unit}",
            f"{steepest:+.3g} / {unit}",
            f"{entry.deviation:.2f}",
            f"{entry.mean_loss:.2f}",
            f"{entry.low_loss:.2f} ± {entry.low_loss_se:.2f}",
            "" if entry.worst_fiber is None else str(entry.worst_fiber),
        )
    Console(file=stream, width=None if stream.isatty() else 100).print(table)
