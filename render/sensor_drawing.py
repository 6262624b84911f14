"""A sensor as one drawing (SVG): the pad from outside and its section, side by side, y upwards.

Both views have one scale and share the height, so that a lamp or a site is on one level in both:
on the left across x, as one looks at the skin; on the right along z, the camera's side on the left.
The flat pad is drawn. Lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.geometry import (
    SkinChart,
    camera_coverage,
    camera_origin,
    declared_sites,
    flat_fiber_poses,
    pixel_directions,
)
from render.scene import OFF, OUTWARD, Profile, Scene

LIGHT = (
    "--paper:#fff;--ink:#1c1f24;--soft:#5b616b;--clear:#e8f0f8;--milky:#d9dbe0;--plate:#cfe3dc;"
    "--lamp:#c2570c"
)
DARK = (
    "--paper:#16181c;--ink:#eceef1;--soft:#a2a8b3;--clear:#24303d;--milky:#3a3e46;--plate:#2b4640;"
    "--lamp:#f0a35e"
)
STYLE = """text{{font:1.15px system-ui,sans-serif;fill:var(--soft)}}
svg{{background:var(--paper);{light}}}{dark}
.pad{{fill:var(--clear);stroke:var(--soft);stroke-width:.08}}.milky{{fill:var(--milky)}}
.window{{fill:var(--plate);stroke:var(--soft);stroke-width:.08}}
.painted{{stroke:var(--soft);stroke-width:.7;stroke-linecap:round}}.black{{stroke:#000}}
.white{{stroke:#fff}}.mirror{{stroke:#8fb4cc}}.black,.white,.mirror{{stroke-width:.46;stroke-linecap:round}}
.rough{{stroke:var(--ink);stroke-width:.3;stroke-dasharray:.15 .35}}
.skin{{stroke:var(--ink);stroke-width:.35}}.site{{fill:var(--ink)}}
.out{{stroke:var(--soft);stroke-width:.14}}.camera{{fill:var(--ink)}}
.lens{{fill:none;stroke:var(--ink);stroke-width:.2}}
.view{{fill:var(--ink);fill-opacity:.05;stroke:var(--soft);stroke-width:.1;stroke-dasharray:.5 .35}}
.cone{{fill-opacity:.25}}.colored{{fill-opacity:.6}}.lamp{{stroke-width:.3}}.dark{{fill:none;stroke:var(--soft);stroke-width:.1}}
.rule{{stroke:var(--soft);stroke-width:.12}}"""
CONE = 3.5
"""Length of a beam's cone, mm."""
MARGIN, LETTERS = 2.0, 2.6
"""Around the views, and above them for their titles, mm."""
FAR = 40.0
"""A camera farther than this below the pad is drawn at this distance, and said so, mm."""
NAME = 5.6
"""Room for the camera's name, mm."""
SKIN_STEPS = 65
"""Points of the line that a curved skin is in the section."""
VIEW_STEPS = 513
"""Places along a line of sight at which it is asked whether it has met a curved skin."""
PIXELS_PER_MM = 12.0


@dataclass(frozen=True, eq=False)
class View:
    """Two axes of space, drawn to the right and upwards from ``low`` to ``high`` ``(2,)`` mm."""

    axes: tuple[int, int]
    low: Array
    high: Array

    def flat(self, points: Array) -> Array:
        """Return drawn positions ``(..., 2)``, y down, of ``points`` ``(..., 3)``."""
        chosen = np.asarray(points)[..., list(self.axes)]
        return np.stack([chosen[..., 0] - self.low[0], self.high[1] - chosen[..., 1]], axis=-1)

    @property
    def size(self) -> Array:
        """Width and height, mm."""
        return self.high - self.low


def sensor_svg(
    scene: Scene,
    phi: Array | None = None,
    inks: Sequence[str | None] | None = None,
    *,
    section: bool = True,
    dark: bool = False,
) -> str:
    """Return the drawing of a sensor as a whole SVG file.

    Arguments:
        scene: the sensor.
        phi: ``(fiber,)`` rad; None is pi/2, straight in.
        inks: color of every lamp, as CSS has it, None for one that is off; None in all draws those
            alike that the baseline lights.
        section: whether the section stands beside the view from outside.
        dark: whether it turns dark where the reader's screen is.
    """
    views = [_view(scene, (0, 1))] + ([_view(scene, (2, 1))] if section else [])
    titles = ["from outside", "section"]
    groups, left = [], MARGIN
    for number, view in enumerate(views):
        width, height = view.size
        parts = "".join(_drawn(scene, view, phi, inks))
        groups.append(
            f'<g transform="translate({left:.3f} {LETTERS:.3f})"><clipPath id="v{number}">'
            f'<rect width="{width:.3f}" height="{height:.3f}"/></clipPath>'
            f'<text x="{width / 2:.3f}" y="-.7" text-anchor="middle">{titles[number]}</text>'
            f'<g clip-path="url(#v{number})">{parts}</g></g>'
        )
        left += width + MARGIN
    height = LETTERS + float(views[0].size[1]) + LETTERS
    turned = f"@media(prefers-color-scheme:dark){{svg{{{DARK}}}}}" if dark else ""
    style = STYLE.format(light=LIGHT, dark=turned)
    foot = (
        f'<path class="rule" d="M{MARGIN:.2f} {height - 1.6:.2f}h5"/>'
        f'<text x="{MARGIN + 5.6:.2f}" y="{height - 1.2:.2f}">5 mm</text>'
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {left:.3f} {height:.3f}" '
        f'width="{PIXELS_PER_MM * left:.0f}" height="{PIXELS_PER_MM * height:.0f}" role="img">'
        f"<title>{scene.name}: lamps, pad, sites and camera</title><style>{style}</style>"
        f"{''.join(groups)}{foot}</svg>\n"
    )


def _view(scene: Scene, axes: tuple[int, int]) -> View:
    """Return the view that holds pad, lamps with their numbers, and the camera where it is near."""
    low, high = scene.box.low, scene.box.high
    poses = flat_fiber_poses(scene)
    points = [np.stack([low, high]), poses.position, poses.position - 1.3 * poses.inward]
    camera = _drawn_camera(scene)
    if (np.abs(camera[:2]) < high[:2] + FAR).all():
        points.append(camera[None])
    if scene.states is not None:
        crowns = [scene.in_state(state).box.high for state in scene.state_axis]
        points.append(np.stack(crowns))
    shown = np.concatenate(points)[:, list(axes)]
    first, last = shown.min(axis=0) - 1.5, shown.max(axis=0) + 1.5
    if axes[0] == 2:
        first[0] -= NAME if -camera_origin(scene)[2] < FAR else 3 * NAME
    return View(axes, first, last)


def _drawn_camera(scene: Scene) -> Array:
    place = camera_origin(scene)
    return np.array([*place[:2], max(place[2], -FAR)])


def _drawn(
    scene: Scene, view: View, phi: Array | None, inks: Sequence[str | None] | None
) -> Iterator[str]:
    low, high = scene.box.low, scene.box.high
    half = np.array([scene.pad.width / 2, scene.pad.length / 2, 0.0])
    clear = -half, half + [0.0, 0.0, scene.pad.thickness]
    if scene.diffuser is not None:
        yield _rectangle(view, low, high, "milky")
    if scene.window is not None:
        yield _rectangle(view, low, high, "window")
    section = view.axes[0] == 2
    if section and scene.skin is not None:
        outline = np.concatenate([_skin_line(scene, 0.0), [-half, half * [-1.0, 1.0, 1.0]][::-1]])
        yield _path(view.flat(outline), "pad")
        yield _path(view.flat(_skin_line(scene, -half[0])), "rule", closed=False, fill="none")
    else:
        yield _rectangle(view, *clear, "pad")
    yield from _faces(scene, view)
    yield from _camera_view(scene, view)
    if section:
        for state in scene.state_axis[1:] if scene.states is not None else ():
            moved = view.flat(_skin_line(scene.in_state(state), 0.0))
            dashes = {"stroke-dasharray": ".8 .5"}
            yield _path(moved, "lens", closed=False, **dashes)
        line = view.flat(_skin_line(scene, 0.0))
        yield _path(line, "skin", closed=False, **({} if scene.skin is None else {"fill": "none"}))
    counted = set(camera_coverage(scene).counted.tolist())
    for number, (x, y) in enumerate(view.flat(declared_sites(scene))):
        if number in counted:
            yield f'<circle class="site" cx="{x:.3f}" cy="{y:.3f}" r=".28"/>'
        else:
            yield f'<path class="out" d="M{x - 0.3:.3f} {y - 0.3:.3f}l.6 .6m0-.6l-.6 .6"/>'
    yield from _lamps(scene, view, phi, inks)


def _skin_line(scene: Scene, x: float) -> Array:
    """Return the skin of the flat pad along y, ``(n, 3)``; two ends where it is straight."""
    y = np.linspace(-0.5, 0.5, 2 if scene.skin is None else SKIN_STEPS) * scene.pad.length
    return SkinChart(scene, 0.0).flat(np.stack([np.full_like(y, x), y], axis=-1))


def _faces(scene: Scene, view: View) -> Iterator[str]:
    """Draw painted faces and those rougher than the smoothest, where the view shows lines."""
    low, high = scene.box.low, scene.box.high
    smoothest = min(finish.roughness for finish in scene.finishes if finish.paint is None)
    for finish, outward in zip(scene.finishes, OUTWARD, strict=True):
        axis = int(np.abs(outward).argmax())
        if axis not in view.axes:
            continue
        ends = np.stack([low, high])
        ends[:, axis] = (high if outward[axis] > 0 else low)[axis]
        if scene.skin is not None and axis == 1:
            ends[1, 2] = SkinChart(scene, 0.0).height(ends[0, :2] * [0.0, 1.0])
        if finish.paint is not None:
            for kind in ("painted", finish.paint.word):
                yield _path(view.flat(ends), kind, closed=False)
        elif finish.roughness > smoothest:
            yield _path(view.flat(ends), "rough", closed=False)


def _lamps(
    scene: Scene, view: View, phi: Array | None, inks: Sequence[str | None] | None
) -> Iterator[str]:
    """Draw every lamp's end, its cone to half of its peak radiance, and its number.

    One that is off is a small circle.
    """
    poses, lamps = flat_fiber_poses(scene), scene.placed_lamps()
    turned = np.full(len(lamps), np.pi / 2) if phi is None else phi
    beams = poses.directions(turned)
    kind = "cone" if inks is None else "colored cone"
    if inks is None:
        inks = [None if color == OFF else "var(--lamp)" for color in scene.baseline_colors()]
    drawn = set()
    for number, (position, beam) in enumerate(zip(poses.position, beams, strict=True)):
        seen = np.round(np.concatenate([position[list(view.axes)], beam[list(view.axes)]]), 6)
        if tuple(seen) in drawn:  # one behind the other
            continue
        drawn.add(tuple(seen))
        ink = inks[number]
        way = beam[list(view.axes)]
        length = float(np.hypot(*way))
        at = view.flat(position)
        if ink is None:
            yield f'<circle class="dark" cx="{at[0]:.3f}" cy="{at[1]:.3f}" r=".3"/>'
            continue
        if length > 0.5:  # seen from the side, else from its front
            aim = way / length * [1.0, -1.0]
            across = np.array([-aim[1], aim[0]])
            end = 0.5 * lamps[number].diameter * across
            spread = _half_peak(lamps[number].profile)
            wide = end + CONE * math.tan(min(spread, math.radians(60.0))) * across
            cone = [at - end, at + end, at + CONE * aim + wide, at + CONE * aim - wide]
            yield _path(np.array(cone), kind, fill=ink)
            yield _path(np.array([at - end, at + end]), "lamp", closed=False, stroke=ink)
        else:
            yield (
                f'<circle cx="{at[0]:.3f}" cy="{at[1]:.3f}" r="{lamps[number].diameter / 2:.3f}" '
                f'fill="{ink}" fill-opacity=".6"/>'
            )
        if view.axes == (0, 1):
            behind = view.flat(position - 1.3 * poses.inward[number])
            yield (
                f'<text x="{behind[0]:.3f}" y="{behind[1] + 0.4:.3f}" '
                f'text-anchor="middle">{number}</text>'
            )


def _camera_view(scene: Scene, view: View) -> Iterator[str]:
    """Draw the camera and where its picture's border meets the lower face and the skin."""
    place = camera_origin(scene)
    border = _border_directions(scene)
    upward = border[border[:, 2] > 0.05]
    met = [place + upward * ((scene.box.low[2] - place[2]) / upward[:, 2:])]
    layers = [(scene.pad.index, scene.pad.thickness)]
    if scene.window is not None:
        layers.insert(0, (scene.window.index, scene.window.thickness))
    for index, height in layers:
        # Snell's law at the lower face of each.
        inside = upward[:, :2] / index
        rise = np.sqrt(1.0 - (inside**2).sum(axis=1))
        way = np.column_stack([inside / rise[:, None], np.ones_like(rise)])
        met.append(met[-1] + height * way)
    if scene.skin is not None:
        met[-1] = _met_skin(scene, met[-2], met[-1])
    skin = met[-1]
    shown = view.flat(_drawn_camera(scene))
    if view.axes == (0, 1):
        if len(skin) > 2:
            yield _path(view.flat(skin), "view")
        yield f'<circle class="lens" cx="{shown[0]:.3f}" cy="{shown[1]:.3f}" r=".7"/>'
        return
    if len(skin) > 2:
        outline = [_drawn_camera(scene)]
        for pick in (np.argmin, np.argmax):
            ends = [points[pick(points[:, 1])] for points in met]
            outline += ends if pick is np.argmin else ends[::-1]
        if scene.skin is not None:
            # Along the skin from one end to the other.
            low, high = outline[2], outline[3]
            y = np.linspace(low[1], high[1], SKIN_STEPS)
            between = np.stack([np.zeros_like(y), y, _height(scene, np.zeros_like(y), y)], axis=-1)
            outline[2:4] = [low, *between, high]
        yield _path(view.flat(np.array(outline)), "view")
    nose = np.array(scene.camera.axes[2])[list(view.axes)] * [1.0, -1.0]
    side = np.array([-nose[1], nose[0]])
    body = [shown, shown - 1.4 * nose + 0.9 * side, shown - 1.4 * nose - 0.9 * side]
    yield _path(np.array(body), "camera")
    far = f" {-place[2]:g} mm below" if place[2] < -FAR else ""
    yield (
        f'<text x="{shown[0] - 1.8:.3f}" y="{shown[1] + 0.4:.3f}" text-anchor="end">'
        f"camera{far}</text>"
    )


def _met_skin(scene: Scene, entry: Array, crown: Array) -> Array:
    """Return where straight ways from ``entry`` to the crown's level meet the skin, ``(n, 3)``.

    Beside the pad the skin is taken to go on at the height of the edge next to it.
    """
    part = np.linspace(0.0, 1.0, VIEW_STEPS)[:, None, None]
    place = entry + part * (crown - entry)
    above = place[..., 2] >= _height(scene, place[..., 0], place[..., 1]) - 1e-9
    return np.asarray(place[above.argmax(axis=0), np.arange(len(entry))])


def _height(scene: Scene, x: Array, y: Array) -> Array:
    half = np.array([scene.pad.width, scene.pad.length]) / 2
    return SkinChart(scene, 0.0).height(np.clip(np.stack([x, y], axis=-1), -half, half))


def _border_directions(scene: Scene) -> Array:
    """Return directions through the border of the picture, ``(n, 3)``, in order."""
    columns, rows = scene.camera.columns, scene.camera.rows
    t = np.linspace(0.0, 1.0, 33)[:-1]
    column = np.concatenate([t, np.ones(32), 1 - t, np.zeros(32)]) * columns
    row = np.concatenate([np.zeros(32), t, np.ones(32), 1 - t]) * rows
    return pixel_directions(scene, columns, rows, column, row)


def _rectangle(view: View, low: Array, high: Array, kind: str) -> str:
    (x0, y1), (x1, y0) = view.flat(np.array([low, high]))
    return (
        f'<rect class="{kind}" x="{x0:.3f}" y="{y0:.3f}" width="{x1 - x0:.3f}" '
        f'height="{y1 - y0:.3f}"/>'
    )


def _path(points: Array, kind: str, *, closed: bool = True, **style: str) -> str:
    ways = "L".join(f"{x:.3f} {y:.3f}" for x, y in points)
    painted = "".join(f' {name}="{value}"' for name, value in style.items())
    return f'<path class="{kind}"{painted} d="M{ways}{"Z" if closed else ""}"/>'


def _half_peak(profile: Profile) -> float:
    """Return the angle (rad) at which radiance is half of its peak, at most 80 deg."""
    theta = np.radians(np.linspace(0.0, 80.0, 321))
    below = np.flatnonzero(profile.radiance(theta) < 0.5)
    return float(theta[below[0]]) if len(below) else float(theta[-1])
