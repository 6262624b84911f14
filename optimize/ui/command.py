"""A command whose refused options are told in the words of refused values in files."""

from __future__ import annotations

import re
from typing import Any

from typer import BadParameter
from typer.core import TyperCommand

from render.memory import START, require_memory
from render.refused_values import allowed_words, did_you_mean
from render.steady_sums import steady_sums

CHOICES = re.compile(r".* is not one of '(.+)'\.", re.DOTALL)
"""What Typer says of a value that is none of an option's choices."""


class Command(TyperCommand):
    """A command line that names the value and what is allowed: Typer lets pydantic speak."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Return what is left of ``args``.

        Raises:
            BadParameter: names option, value and what is allowed.
        """
        try:
            return super().parse_args(ctx, args)
        except BadParameter as error:
            problems = getattr(error.__cause__, "errors", None)
            if problems is not None:  # pydantic's, where Typer reads options by it
                problem = problems()[0]
                allowed, said = allowed_words(problem), problem["msg"].removeprefix("Value error, ")
                error.message = f"{problem['input']}, allowed: {allowed}" if allowed else said
                if choices := CHOICES.fullmatch(said):
                    error.message += did_you_mean(problem["input"], choices[1].split("', '"))
            raise

    def invoke(self, ctx: Any) -> Any:
        """Run the command on steady sums, if there is memory for what it imports.

        Raises:
            RenderError: there is not.
        """
        require_memory(START, "this command")
        with steady_sums():
            return super().invoke(ctx)
