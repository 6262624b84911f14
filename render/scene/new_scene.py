"""A commented scene file from a few answers: what is not answered is assumed, and says so."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from render.errors import SceneError
from render.refused_values import did_you_mean
from render.scene.lamps import EDGES, RIM_EDGES
from render.scene.quantities import allowed_range

GIVEN, ASSUMED = "as given to tactilux new", "assumed"
INDEX = 1.41
BEAM = 'half_angle = { value = 23.4, unit = "deg", source = "assumed: the end of a fiber" }'
LAMPS = {
    "fiber": (0.75, 0.4, (10.0, "assumed: a slight angle towards the skin, as in the thesis"),
              f"profile = {{ {BEAM} }}\nturns = true"),
    "led": (1.0, 0.1, (0.0, "assumed: straight in"),
            "profile = \"lambertian\"  # assumed\nturns = false"),
}  # fmt: skip
"""Diameter and gap in mm, tilt in deg with its source, profile: what a lamp is assumed to be."""
COLORS = {"red": (1.0, 0.0, 0.0), "green": (0.0, 1.0, 0.0), "blue": (0.0, 0.0, 1.0),
          "white": (1.0, 1.0, 1.0), "amber": (1.0, 0.5, 0.0),
          "infrared": (0.3, 0.3, 0.3)}  # fmt: skip
"""What the red, green and blue channel see of an LED, relative to its power."""
GRAY = dict.fromkeys(COLORS, 1.0) | {"infrared": 0.4}
"""What the one channel of a gray camera sees of them."""
CAMERAS = ("color", "gray")
PIXELS = 600
PLACES = 200
"""Along all edges, at most: tables of more take minutes."""


@dataclass(frozen=True)
class Question:
    """A number that a new scene needs.

    Arguments:
        words: what is asked.
        low, high: closed allowed range, in ``unit``.
        default: what is assumed; None where other answers decide.
    """

    words: str
    unit: str
    low: float
    high: float
    default: float | None

    def number(self, said: str) -> float:
        """Return what was typed as a number, whole where lamps are counted."""
        try:
            value = float(said)
        except ValueError:
            value = math.nan
        if math.isnan(value) or (not self.unit and value != round(value)):
            kind = "a whole number" if not self.unit else "a number"
            raise SceneError(
                f"{said}, allowed: {kind}, {allowed_range(self.low, self.high, self.unit)}"
            )
        return value

    def check(self, name: str, value: float) -> None:
        """Refuse a ``value`` out of range."""
        if not self.low <= value <= self.high:
            allowed = allowed_range(self.low, self.high, self.unit)
            raise SceneError(f"{flag_of(name)} = {value:g}, allowed: {allowed}", field=name)


QUESTIONS = {
    "width": Question("width of the pad, across", "mm", 4.0, 100.0, 18.0),
    "length": Question("length of the pad, from base to tip", "mm", 4.0, 100.0, 30.0),
    "thickness": Question("thickness of the clear gel", "mm", 1.0, 50.0, 4.0),
    "diffuser": Question("thickness of the diffuser on the edges, 0 for none",
                         "mm", 0.0, 20.0, 2.0),
    "left": Question("lamps along the left edge", "", 0, 64, 8),
    "tip": Question("lamps along the tip", "", 0, 64, 4),
    "right": Question("lamps along the right edge", "", 0, 64, 8),
    "base": Question("lamps along the base", "", 0, 64, 0),
    "distance": Question("from the camera to the pad", "mm", 1.0, 500.0, None),
    "field_of_view": Question("field of view of the camera, along the pad",
                              "deg", 5.0, 170.0, None),
    "place_lamps": Question("lamps that explore may place along the edges, 0 to leave all",
                            "", 0, 64, 0),
}  # fmt: skip
"""By the names of the flags, with dashes there."""


def flag_of(name: str) -> str:
    """Return the option that answers a question.

    >>> flag_of("field_of_view")
    '--field-of-view'
    """
    return "--" + name.replace("_", "-")


def check_name(name: str) -> None:
    """Refuse a name that no scene can have.

    Raises:
        SceneError: says what is allowed.
    """
    if not re.fullmatch(r"[a-z0-9][a-z0-9_-]{0,63}", name):
        raise SceneError(
            f"name = {name or 'nothing'}, allowed: small letters, digits, - and _, at most 64",
            field="name",
        )


@dataclass(frozen=True)
class Answers:
    """What is known of a new sensor; the rest is assumed.

    Arguments:
        name: of the scene.
        numbers: by the names of `QUESTIONS`; those that nobody answered are absent.
        lamp: one of `LAMPS`.
        colors: of the lit edges, in the order of `EDGES`, of `COLORS`, or one for all; empty for
            red, blue, green and red, or before a gray camera for white.
        camera: one of `CAMERAS`.
    """

    name: str
    numbers: Mapping[str, float]
    lamp: str = "fiber"
    colors: tuple[str, ...] = ()
    camera: str = "color"

    def __post_init__(self) -> None:
        """Refuse what no sensor can be.

        Raises:
            SceneError: names the flag, its value and what is allowed.
        """
        check_name(self.name)
        for name, value in self.numbers.items():
            QUESTIONS[name].check(name, value)
        self._check_lamps()
        for color in self.colors:
            if color not in COLORS:
                raise SceneError(
                    f"--colors names {color}, allowed: {', '.join(COLORS)}"
                    f"{did_you_mean(color, COLORS)}",
                    field="colors",
                )
        if len(self.colors) not in (0, 1, len(self.lit)):
            raise SceneError(
                f"--colors names {len(self.colors)} colors, allowed: {len(self.lit)}, one for each "
                f"edge with lamps ({', '.join(self.lit)}), or one for all",
                field="colors",
            )

    def _check_lamps(self) -> None:
        for edge in EDGES:
            most = min(self._places(edge), 64)
            if self.size(edge) > most:
                raise SceneError(
                    f"--{edge} = {self.size(edge):g}, allowed: 0 to {most} lamps of "
                    f"{self.diameter:g} mm side by side",
                    field=edge,
                )
        if not self.lit:
            raise SceneError(
                "--left, --tip, --right and --base are 0, allowed: at least one lamp", field="left"
            )

    @property
    def lit(self) -> tuple[str, ...]:
        """The edges with lamps."""
        return tuple(edge for edge in EDGES if self.size(edge) > 0)

    @property
    def edge_colors(self) -> dict[str, str]:
        """The color of each edge with lamps."""
        usual = ("white",) if self.camera == "gray" else ("red", "blue", "green", "red")
        chosen = self.colors or usual[: len(self.lit)]
        if len(chosen) == 1:
            chosen *= len(self.lit)
        return dict(zip(self.lit, chosen, strict=True))

    def size(self, name: str) -> float:
        """Return an answer, or what is assumed instead."""
        if name in self.numbers:
            return self.numbers[name]
        default = QUESTIONS[name].default
        assert default is not None
        if name in EDGES and default:
            # At most every second place of a short edge.
            return max(min(default, self._places(name) // 2), 1)
        return default

    @property
    def view(self) -> tuple[float, float]:
        """Distance (mm) and field of view (deg) of the camera, by default of the whole pad."""
        usual = round(max(self.size("width"), self.size("length")) / 3, 1)
        distance = self.numbers.get("distance", usual)
        optical = distance + self.size("thickness") / INDEX
        whole = math.ceil(2 * math.degrees(math.atan(self.size("length") / 2 / optical)))
        return distance, self.numbers.get("field_of_view", float(min(whole, 170)))

    def _places(self, edge: str) -> int:
        """Return how many lamps fit along an edge, side by side."""
        return int(self.size("width" if edge in ("tip", "base") else "length") / self.diameter)

    @property
    def diameter(self) -> float:
        """Of a lamp, mm."""
        return LAMPS[self.lamp][0]


def scene_file(answers: Answers) -> str:
    """Return the TOML text of the scene file."""
    camera = _Camera.of(answers)
    return "\n".join(
        [
            _head(answers),
            _pad(answers),
            *([_diffuser(answers)] if answers.size("diffuser") > 0 else []),
            '[coating]\nalbedo = { value = 0.6, source = "assumed: gray paint" }\n',
            *_lamps(answers),
            camera.text,
            "# A pad that bends has more angles, such as [0.0, 45.0, 90.0].\n"
            '[bending]\nangles = { value = [0.0], unit = "deg", source = "assumed: rigid" }\n',
            _sites(answers, camera),
            "# The design that others are compared with.\n[baseline]\n"
            + "\n".join(f'{edge} = "{color}"' for edge, color in answers.edge_colors.items()),
            *_other_colors(answers),
            *_search(answers),
        ]
    ).rstrip() + "\n"  # fmt: skip


def _search(answers: Answers) -> Iterator[str]:
    """Yield what a search may decide: a rail along each edge with lamps."""
    most = int(answers.size("place_lamps"))
    if not most:
        return
    yield (
        "\n# What tactilux explore may decide: at most so many lamps are lit, on any places.\n"
        "# between, heights and tilt say more of a rail; keep_out names parts that are taken.\n"
        f"[search]\nlamps = {most}  # {GIVEN}\n"
    )
    whole = sum(answers.size("width" if edge in ("tip", "base") else "length")
                for edge in answers.lit)  # fmt: skip
    wide = max(2 * answers.diameter, math.ceil(whole / PLACES))
    pitch = _quantity("pitch", wide, "mm", "assumed: at least two diameters of a lamp")
    for edge in answers.lit:
        yield f'[[search.places]]\nedge = "{edge}"\n{pitch}\n'


def _quantity(name: str, value: float, unit: str, source: str) -> str:
    unit = f', unit = "{unit}"' if unit else ""
    return f'{name} = {{ value = {float(value)!r}{unit}, source = "{source}" }}'


def _origin(answers: Answers, name: str) -> str:
    return GIVEN if name in answers.numbers else ASSUMED


def _answered(answers: Answers, name: str, key: str = "") -> str:
    source = _origin(answers, name)
    return _quantity(key or name, answers.size(name), QUESTIONS[name].unit, source)


def _said(answers: Answers, *names: str) -> str:
    """Return the sizes of the pad that a value comes from, as `render.describe` looks for them."""
    return " and ".join(f"pad.{name} = {answers.size(name):g} mm" for name in names)


def _head(answers: Answers) -> str:
    return f"""# Written by tactilux new. Every value has its unit and its source: those that are assumed await
# a data sheet, a caliper or `tactilux hw calibrate`; `tactilux describe` lists them all.
# x runs across the pad, y from its base to its tip, z from the camera's side to the skin.
schema = 2
name = "{answers.name}"
"""  # noqa: E501


def _pad(answers: Answers) -> str:
    return "\n".join(
        [
            "# The clear gel. Roughness is Beckmann's alpha of its outer faces; 0 is polished.",
            "[pad]",
            *(_answered(answers, name) for name in ("width", "length", "thickness")),
            _quantity("index", INDEX, "", "assumed: clear silicone"),
            _quantity("roughness", 0.1, "", "assumed: molded faces"),
            "",
        ]
    )


def _diffuser(answers: Answers) -> str:
    return "\n".join(
        [
            "# The scattering layer on the left, tip and right edge, of the same index as the pad.",
            "[diffuser]",
            _answered(answers, "diffuser", "thickness"),
            _quantity("sigma_s", 4.0, "1/mm", "assumed: reduced scattering 1 /mm"),
            _quantity("sigma_a", 0.005, "1/mm", "assumed"),
            _quantity("g", 0.75, "", "assumed"),
            "",
        ]
    )


def _lamps(answers: Answers) -> list[str]:
    """Return fibers in the one section that jigs and calibration know, or else a row per edge."""
    if answers.lamp != "fiber" or answers.lit != RIM_EDGES:
        return [_row(answers, edge) for edge in answers.lit]
    counts = [f"{edge} = {int(answers.size(edge))}  # {_origin(answers, edge)}"
              for edge in RIM_EDGES]  # fmt: skip
    head = "# Optical fibers, which may turn, evenly spaced along three edges.\n[fibers]"
    return ["\n".join([head, *counts, *_lamp(answers), BEAM, ""])]


def _row(answers: Answers, edge: str) -> str:
    noun = (
        "optical fibers, which may turn" if answers.lamp == "fiber" else "LEDs, which do not turn"
    )
    return "\n".join(
        [
            f"# Along the {edge}: {noun}. `at` instead of `count` names places.",
            "[[rows]]",
            f'edge = "{edge}"',
            f"count = {int(answers.size(edge))}  # {_origin(answers, edge)}",
            *_lamp(answers),
            LAMPS[answers.lamp][3],
            "",
        ]
    )


def _lamp(answers: Answers) -> list[str]:
    """Return what is assumed of the size and the place of every lamp."""
    diameter, gap, tilt, _ = LAMPS[answers.lamp]
    half = f"assumed: half of {_said(answers, 'thickness')}"
    return [
        _quantity("diameter", diameter, "mm", ASSUMED),
        _quantity("gap", gap, "mm", "assumed: air before the pad or its diffuser"),
        _quantity("height", answers.size("thickness") / 2, "mm", half),
        _quantity("tilt", tilt[0], "deg", tilt[1]),
    ]


@dataclass(frozen=True)
class _Camera:
    """What the camera sees of the skin.

    Arguments:
        text: the section of the scene file.
        half: half of the seen part of the skin across and along the pad, mm.
    """

    text: str
    half: tuple[float, float]

    @staticmethod
    def of(answers: Answers) -> _Camera:
        width, length = answers.size("width"), answers.size("length")
        # The longer side of the picture has PIXELS, and its shape is that of the pad.
        pixel = max(width, length) / PIXELS
        columns, rows = (max(round(side / pixel), 8) for side in (width, length))
        distance, angle = answers.view
        optical = distance + answers.size("thickness") / INDEX
        viewed = GIVEN
        if "field_of_view" not in answers.numbers:
            place = f"camera.distance = {distance:g} mm"
            viewed = f"assumed: all of {_said(answers, 'length')} from {place}"
        placed = GIVEN
        if "distance" not in answers.numbers:
            placed = f"assumed: a third of the longer of {_said(answers, 'width', 'length')}"
        half = optical * math.tan(math.radians(angle) / 2)
        lines = [
            "# A pinhole: photographs are dewarped. It looks straight at the skin from below.",
            "[camera]",
            _quantity("distance", distance, "mm", placed),
            _quantity("y", 0.0, "mm", "assumed: below the middle"),
            _quantity("field_of_view", angle, "deg", viewed),
            f"columns = {columns}  # assumed",
            f"rows = {rows}  # assumed",
            *(['channels = ["gray"]'] if answers.camera == "gray" else []),
            "",
        ]
        return _Camera("\n".join(lines), (half * columns / rows, half))


def _sites(answers: Answers, camera: _Camera) -> str:
    """Return sites that fit on the part of the skin that is seen, and their pyramid."""
    sides = [answers.size("width"), answers.size("length")]
    seen = [min(side / 2, half) for side, half in zip(sides, camera.half, strict=True)]
    radius = min(max(0.6, max(sides) / 50), answers.size("thickness"), min(seen) / 2)
    radius = max(math.floor(20 * radius) / 20, 0.05)
    # Between the outermost centers: pyramids must not leave the pad, nor what is seen of it, and
    # beside the edges the nearest lamp alone would set the exposure.
    room = [0.8 * max(2 * (0.95 * half - 1.5 * radius), 0.0) for half in seen]
    columns, rows, spacing = _grid(room, 3 * radius)
    source = f"assumed: over what is seen of {_said(answers, 'width', 'length')}"
    return "\n".join(
        [
            "# Where the skin is tested: contacts in a grid, each a small pyramid.",
            "[sites]",
            f"columns = {columns}",
            f"rows = {rows}",
            _quantity("spacing", spacing, "mm", source),
            _quantity("centre_x", 0.0, "mm", ASSUMED),
            _quantity("centre_y", 0.0, "mm", ASSUMED),
            "",
            "[indenter]",
            "faces = 10",
            _quantity("slope", 30.0, "deg", ASSUMED),
            _quantity("radius", radius, "mm", f"assumed: for {_said(answers, 'width', 'length')}"),
            "",
        ]
    )


FEWEST, MOST, COVERED = 15, 25, 0.8
"""Sites of a new scene, and the part of the room for their centers that they reach over."""


def _grid(room: list[float], least: float) -> tuple[int, int, float]:
    """Return columns, rows and spacing (mm) of sites over ``room`` (x, y; mm).

    They are `FEWEST` to `MOST`, as few as reach over `COVERED` of the room, and if none do those
    that reach over most of it; ``least`` mm apart, so that pyramids do not touch.
    """
    steps = [side / count for side in room for count in range(1, 12)]
    # In twentieths of a mm.
    steps = [math.floor(20 * step) / 20 for step in steps if step >= least + 0.05]
    across, along = room
    grids = [(int(across / s + 1e-9) + 1, int(along / s + 1e-9) + 1, s) for s in steps]
    grids = [grid for grid in grids if grid[0] * grid[1] <= MOST]
    if not grids:
        return 1, 1, math.ceil(20 * least + 1) / 20

    def reach(grid: tuple[int, int, float]) -> float:
        sides = zip(grid[:2], room, strict=True)
        # Where there is no room for two, one is all.
        return math.prod((n - 1) * grid[2] / side for n, side in sides if side >= least + 0.05)

    good = [grid for grid in grids if grid[0] * grid[1] >= FEWEST and reach(grid) >= COVERED]
    if good:
        return min(good, key=lambda grid: (grid[0] * grid[1], -reach(grid)))
    return max(grids, key=lambda grid: (reach(grid), grid[0] * grid[1]))


def _other_colors(answers: Answers) -> list[str]:
    """Return the LEDs, where they or the camera are other than red, green and blue.

    A baseline of one color has no hue to score by. So where all edges have the same, there is no
    LED of another.
    """
    used, gray = set(answers.edge_colors.values()), answers.camera == "gray"
    usual = set() if gray or len(used) == 1 else {"red", "green", "blue"}
    if used <= usual:
        return []
    channels = "the gray channel" if gray else "the channels red, green and blue"
    lines = ["", f"# What {channels} of the camera see{'s' if gray else ''} of each LED."]
    if gray or len(used) == 1:
        look = "The camera sees no hue" if gray else "All have one color"
        lines.append(f"# {look}, so that scores know brightness alone.")
    for name in COLORS:
        if name not in used | usual:
            continue
        response = [GRAY[name]] if gray else list(COLORS[name])
        source = "assumed" if gray else "assumed: no overlap of channels"
        shown = f'{{ value = {response}, source = "{source}" }}'
        lines += ["[[colors]]", f'name = "{name}"', f"response = {shown}", ""]
    return lines
