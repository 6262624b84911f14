"""What calibration looks for: the material of the rig, a scene that has it, and its range.

A material is an array ``(quantity,)`` of what its scene's `MaterialSpace` fits. Behind a diffuser
these are scattering, absorption, the beams' width and the roughness; on a clear pad the albedo of
the skin, the roughness of the faces that lamps shine through, and the beams' width of fibers.

A skin may have an albedo for each channel of the camera. Light of a channel is that of the sensor
whose whole skin has its albedo, so each channel has a material of its own, of one albedo: the
rig's, less the albedos of the other channels.

Over the range, log light is a polynomial of the second degree in unit coordinates: -1 to 1 between
the ends, of scattering's logarithm (`surrogate.model.materials.MaterialRange`), and the logarithm
of the albedo beside it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from hw.errors import CalibrationError
from render.arrays import Array
from render.scene.lamps import FACES
from render.scene.quantities import unchecked
from surrogate.model.materials import MaterialRange
from tactilux import Scene

Place = tuple[str | int, ...]
"""Where a value stands in a scene and in its file: keys, and numbers of entries."""


@dataclass(frozen=True)
class FittedQuantity:
    """One value of a material.

    Arguments:
        name, title, unit: for programs, for people, and that of files.
        low, high: where it is looked for; angles in rad.
        squared: whether its square is fitted.
        most: what it cannot exceed.
        per_unit: what values are multiplied with to be told in ``unit``.
        may_vanish: whether it may well be as small as the range allows.
        factor: whether light is nearly in proportion to it.
    """

    name: str
    title: str
    unit: str
    low: float
    high: float
    per_unit: float = 1.0
    squared: bool = False
    most: float = math.inf
    may_vanish: bool = False
    factor: bool = False


@dataclass(frozen=True)
class Knowledge:
    """What is known of a value before any photograph: that it is near the scene's.

    Of one that is squared, they are those of its root.

    Arguments:
        known, held: standard deviations of what is known, and with which the fit holds it.
        relative: whether they are relative to the scene's value.
    """

    known: float
    held: float
    relative: bool = False


SCATTERING = FittedQuantity("reduced_scattering", "reduced scattering", "1/mm", 0.55, 1.8)
"""sigma_s (1 - g). Silicones filled for diffusion lie between 0.5 and 2 /mm."""
ABSORPTION = FittedQuantity("absorption", "absorption", "1/mm", 0.0, 0.06, may_vanish=True)
SIGMA_V = FittedQuantity(
    "sigma_v", "beam width sigma_v", "deg", math.radians(9.0), math.radians(22.0), 180 / math.pi
)
ROUGHNESS = FittedQuantity("roughness", "roughness alpha", "", 0.03, 0.25, may_vanish=True)
ALBEDO = FittedQuantity("albedo", "albedo of the skin", "", 0.1, 0.9, most=1.0, factor=True)
LIT_ROUGHNESS = FittedQuantity(
    "roughness", "roughness of lit faces", "", 0.0, 0.3, squared=True, may_vanish=True
)
"""Faces spread light by angles of random slopes, whose variance is what shapes of light grow with:
a polynomial of the roughness itself would tell 0.05 from 0, which no light does."""

DIFFUSE_CAVEATS = (
    "g and sigma_s cannot be separated by photographs: sigma_s (1 - g) is calibrated, g kept.",
    "The roughness is held near the scene's: photographs hardly tell it, and what is not known of "
    "it widens the other intervals.",
    "Powers and gains share one factor: the powers' mean is 1.",
)
CLEAR_CAVEAT = (
    "The albedo is told by the shape of the light alone, weighed with the scene's value, known to "
    "0.2: powers, gains and the brightness of the skin share one factor, and the powers' mean is 1."
)
ROUGHNESS_CAVEAT = (
    "The roughness of lit faces hardly shows below 0.1: the scene's value, known to 0.1, is "
    "weighed with the photographs."
)


@dataclass(frozen=True, eq=False)
class MaterialSpace:
    """The quantities that are fitted for a scene: where they stand, their range, the polynomial.

    Arguments:
        quantities: in the order of a material's values.
        places: of each, where it stands in the scene; a value may stand in several entries.
        factors: of each, what the scene's value is multiplied with to be the material's.
        knowledge: by the number of the quantity, of those of which something is known.
        caveats: what photographs cannot tell, one sentence each.
        of_channel: where channels have materials of their own, of each the numbers of its
            quantities among those of the rig.
    """

    quantities: tuple[FittedQuantity, ...]
    places: tuple[tuple[Place, ...], ...]
    factors: tuple[float, ...]
    knowledge: Mapping[int, Knowledge]
    caveats: tuple[str, ...]
    of_channel: tuple[tuple[int, ...], ...] = ()

    def seen(self, material: Array) -> Array:
        """Return the material that light of each channel meets, ``([channel,] quantity)``.

        Without an axis of channels where all meet the rig's ``material`` ``(quantity,)``.
        """
        return material[np.array(self.of_channel)] if self.of_channel else material

    @property
    def names(self) -> tuple[str, ...]:
        """Of all quantities."""
        return tuple(quantity.name for quantity in self.quantities)

    @cached_property
    def low(self) -> Array:
        """Lowest material."""
        return self.material(np.array([quantity.low for quantity in self.quantities]))

    @cached_property
    def high(self) -> Array:
        """Highest material."""
        return self.material(np.array([quantity.high for quantity in self.quantities]))

    @cached_property
    def _squared(self) -> Array:
        return np.array([quantity.squared for quantity in self.quantities])

    def material(self, values: Array) -> Array:
        """Return the material of ``values`` ``(..., quantity)``."""
        return np.where(self._squared, values**2, values)

    def values(self, materials: Array) -> Array:
        """Return what ``materials`` ``(..., quantity)`` are: roots of what is fitted squared.

        Below 0 there are none.
        """
        return np.where(self._squared, np.sqrt(np.maximum(materials, 0.0)), materials)

    def told(self, materials: Array) -> Array:
        """Return values of ``materials`` ``(..., quantity)`` in their units."""
        return self.values(materials) * [quantity.per_unit for quantity in self.quantities]

    def deviations(self, before: Array) -> tuple[Array, Array]:
        """Return standard deviations of what is known of a material, and with which it is held.

        For the quantities of ``knowledge``, in its order; ``before`` is the scene's material.
        """
        found = []
        for number, one in self.knowledge.items():
            value = float(self.values(before)[number])
            both = np.array([one.known, one.held]) * (value if one.relative else 1.0)
            squared = self.quantities[number].squared
            found.append(both * (2 * value + both) if squared else both)
        known, held = np.array(found).reshape(-1, 2).T
        return known, held

    @property
    def neutral(self) -> Array:
        """A material that stands for all in the names of files."""
        return np.sqrt(self.low * self.high) + 0.01

    @property
    def enough(self) -> int:
        """How many materials tell the polynomial: twice its terms, and a power of two."""
        return 1 << int(np.ceil(np.log2(2 * len(self.exponents))))

    @cached_property
    def _range(self) -> MaterialRange:
        return MaterialRange(self.names, self.low, self.high, nominal=self.low)

    @cached_property
    def exponents(self) -> Array:
        """Exponents ``(term, quantity)`` of the polynomial's terms, the constant first."""
        constant = np.zeros((1, len(self.quantities)), dtype=np.int64)
        return np.concatenate([constant, self._range.exponents])

    def of(self, scene: Scene) -> Array:
        """Return the material of ``scene``."""
        values = [_value_at(scene, places[0]) for places in self.places]
        return self.material(np.array(values) * self.factors)

    def put_into(self, scene: Scene, material: Array) -> Scene:
        """Return ``scene`` with ``material``; what is not fitted is kept."""
        values = self.values(material)
        for places, factor, value in zip(self.places, self.factors, values, strict=True):
            for place in places:
                scene = _changed(scene, place, float(value) / factor)
        return scene

    def sobol(self, count: int) -> Array:
        """Return ``count`` materials ``(material, quantity)`` that fill the range."""
        from scipy.stats import qmc

        size = len(self.quantities)
        sampler = qmc.Sobol(size, scramble=True, rng=np.random.default_rng(1))
        unit = sampler.random_base2(int(np.ceil(np.log2(count))))[:count]
        return self._range.from_unit(2 * unit - 1)

    def terms(self, materials: Array) -> Array:
        """Return the polynomial's terms ``(..., term)`` of materials ``(..., quantity)``."""
        unit = self._range.unit(materials)[..., None, :]
        return np.asarray(np.prod(unit**self.exponents, axis=-1))

    def log_factor(self, materials: Array) -> Array:
        """Return the log ``(...)`` of what light is in proportion to, beside the polynomial."""
        factors = [quantity.factor for quantity in self.quantities]
        return np.asarray(np.log(materials[..., factors]).sum(axis=-1))

    def log_factor_slope(self, material: Array) -> Array:
        """Return its derivatives ``(quantity,)`` by the values of one material."""
        return np.array([one.factor for one in self.quantities]) / np.maximum(material, 1e-12)

    def terms_slope(self, material: Array) -> Array:
        """Return the terms' derivatives ``(quantity, term)`` by the values of one material."""
        logs, span = self._range.logarithmic, self.high - self.low
        span[logs] = np.log(self.high[logs] / self.low[logs]) * material[logs]
        scale = 2 / span
        identity = np.eye(len(material), dtype=int)[:, None]
        # (quantity, term, quantity)
        lower = np.maximum(self.exponents - identity, 0)
        powers = np.prod(self._range.unit(material) ** lower, axis=-1)
        return np.asarray(scale[:, None] * self.exponents.T * powers)


def check_one_shot(scene: Scene) -> None:
    """Refuse a scene of several shots: its channels are one camera's, seen several times.

    Raises:
        CalibrationError: says which key, and what fits.
    """
    if scene.palette.shots > 1:
        raise CalibrationError(
            f"camera.shots = {scene.palette.shots} of {scene.name}, allowed: 1 to calibrate; leave "
            "the key out of the scene file, photographs of single pictures tell all",
            field="camera.shots",
        )


def material_space(scene: Scene) -> MaterialSpace:
    """Return what is fitted for ``scene``.

    Raises:
        CalibrationError: its skin is curved or has several albedos behind a diffuser, a diffuser is
            lit by lamps in rows or lists, or lamps shine through faces of several roughnesses.
    """
    if scene.by_channel:
        return _space_by_channel(scene)
    if scene.skin is not None:
        raise CalibrationError(
            f"scene {scene.name} has a curved skin, calibration reads lines on flat pads and bent "
            "slabs: choose a scene without [skin]; `tactilux hw set`, `capture` and "
            "`tactilux check` do with it",
            field="skin",
        )
    sigma_v: Place = ("fibers", "sigma_v")
    layer = scene.diffuser
    if layer is not None:
        if scene.fibers is None or scene.lamps:
            raise CalibrationError(
                f"scene {scene.name} has lamps in rows or lists of their own behind its diffuser, "
                "calibration knows fibers of one sigma_v there: choose a scene with [fibers] alone",
                field="rows",
            )
        return MaterialSpace(
            (SCATTERING, ABSORPTION, SIGMA_V, ROUGHNESS),
            (
                (("diffuser", "sigma_s"),),
                (("diffuser", "sigma_a"),),
                (sigma_v,),
                (("pad", "roughness"),),
            ),
            (1 - layer.g, 1.0, 1.0, 1.0),
            # The faces change the light by less than the model's errors: free, the roughness of
            # five emulated rigs came out 32 to 68 % too small, and took sigma_v with it by up to
            # 26 %.
            {3: Knowledge(known=0.3, held=0.05, relative=True)},
            DIFFUSE_CAVEATS,
        )
    if scene.coating.lobe is not None:
        raise CalibrationError(
            f"scene {scene.name}: coating.specular = {scene.coating.lobe[0]:g}, allowed for the "
            "calibration of clear pads: a Lambertian skin, whose albedo it fits; leave specular "
            "and roughness out of a copy of the scene to calibrate with",
            field="coating.specular",
        )
    quantities, caveats = [ALBEDO], [CLEAR_CAVEAT]
    places: list[tuple[Place, ...]] = [(("coating", "albedo"),)]
    # Where light does not come back from the faces, the shape of the light says nothing of it.
    knowledge = {0: Knowledge(known=0.2, held=0.2)}
    if scene.pad.index > 1.0:
        knowledge[len(quantities)] = Knowledge(known=0.1, held=0.1)
        quantities.append(LIT_ROUGHNESS)
        places.append(_lit_roughness(scene))
        caveats.append(ROUGHNESS_CAVEAT)
    if scene.fibers is not None:
        quantities.append(SIGMA_V)
        places.append((sigma_v,))
    return MaterialSpace(
        tuple(quantities), tuple(places), (1.0,) * len(places), knowledge, tuple(caveats)
    )


def _space_by_channel(scene: Scene) -> MaterialSpace:
    """Return the space of a skin with an albedo per channel: an albedo of each, then the rest."""
    if scene.diffuser is not None:
        shown = ", ".join(f"{albedo:g}" for albedo in scene.albedos)
        raise CalibrationError(
            f"coating.albedo of scene {scene.name} differs by channel ({shown}), allowed for "
            "calibration behind a diffuser: one number, as the response matrix that is measured "
            "has the skin's color in it; give the mean of the channels",
            field="coating.albedo",
        )
    one, channels = material_space(scene.with_albedo(scene.albedos[0])), scene.palette.channels
    albedo, *rest = one.quantities
    count, more = len(channels), range(len(rest))
    return MaterialSpace(
        quantities=(
            *(
                replace(albedo, name=f"{albedo.name}_{name}", title=f"albedo in {name}")
                for name in channels
            ),
            *rest,
        ),
        places=(*((("coating", "albedo", number),) for number in range(count)), *one.places[1:]),
        factors=(1.0,) * (count + len(rest)),
        knowledge=dict.fromkeys(range(count), one.knowledge[0])
        | {number + count - 1: known for number, known in one.knowledge.items() if number},
        caveats=one.caveats,
        of_channel=tuple((number, *(count + other for other in more)) for number in range(count)),
    )


def _lit_roughness(scene: Scene) -> tuple[Place, ...]:
    """Return where the roughness of the faces that lamps shine through stands."""
    lit = {FACES[lamp.face] for lamp in scene.placed_lamps()}
    rough = {
        face: number
        for number, entry in enumerate(scene.faces or ())
        if entry.roughness is not None
        for face in entry.on
    }
    places: list[Place] = [("faces", number, "roughness") for number in
                           sorted({rough[face] for face in lit if face in rough})]  # fmt: skip
    if lit - rough.keys():
        places.append(("pad", "roughness"))
    values = [_value_at(scene, place) for place in places]
    if len(set(values)) > 1:
        raise CalibrationError(
            f"scene {scene.name}: its lamps shine through faces of the roughnesses "
            f"{', '.join(f'{value:g}' for value in values)}, allowed for calibration: one; give "
            f"{', '.join(sorted(lit))} the same in [[faces]]",
            field="faces.roughness",
        )
    return tuple(places)


def _value_at(part: Any, place: Place) -> float:
    for key in place:
        part = part[key] if isinstance(key, int) else getattr(part, key)
    return float(part)


def _changed(part: Any, place: Place, value: float) -> Any:
    """Return a copy of ``part`` with ``value`` at ``place``."""
    if not place:
        return value
    key, *rest = place
    if isinstance(key, int):
        return (*part[:key], _changed(part[key], tuple(rest), value), *part[key + 1 :])
    return unchecked(part, {key: _changed(getattr(part, key), tuple(rest), value)})
