"""The gate that all photographs in files pass: form, full scale, exposure, lens, size, gamma.

A folder of a sweep holds ``dark``, ``all`` and ``fiber-00``, ``fiber-01``, ...; ``hw/README.md``
describes it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from hw.camera.full_scale import FULL_SCALE, check_exposure, full_scale, in_counts
from hw.camera.lens import load_lens
from hw.camera.photo_file import Photo, read_photo
from hw.camera.photo_set import SAVED_SCALE, PhotoSet, check_dark, check_photo, linear, photo_set
from hw.camera.projection import Dewarp
from hw.errors import CaptureError
from optimize.ui.console import note
from optimize.ui.output import MANIFEST
from render.arrays import Array
from render.files import read_json
from tactilux import Scene

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy")
NAME = re.compile(r"dark|all|fiber-0*(\d+)")
NEARLY = re.compile(r"(dark|all|fib(er|re))([\W_\d].*)?")
"""Names that somebody may have meant to be a photograph of a sweep."""


@dataclass(frozen=True)
class PhotoReader:
    """Reads photographs of a scene's camera.

    Arguments:
        scene: whose camera took them.
        lens: file of the lens that is undone (None: they are the scene's camera's already).
        full_scale: value at which the camera saturates (None: found).
        gamma: that is undone, 1 of linear photographs.
    """

    scene: Scene
    lens: Path | None = None
    full_scale: float | None = None
    gamma: float = 1.0
    _found: dict[float, Path] = field(default_factory=dict, repr=False, compare=False)
    """Full scales that were found so far, and where."""

    @cached_property
    def _dewarp(self) -> Dewarp | None:
        return None if self.lens is None else Dewarp(load_lens(self.lens), self.scene)

    def together(self, path: Path) -> PhotoSet:
        """Return the one photograph of all fibers, without a dark frame.

        Raises:
            CaptureError: it cannot be used; says why and what to do.
        """
        counts, lost = self._counts({path: self._photo(path)}, self.full_scale)
        return PhotoSet({}, linear(counts[path], self.gamma), lost)

    def sweep(self, folder: Path) -> PhotoSet:
        """Return the sweep in a folder.

        Raises:
            CaptureError: it cannot be used; names the file and says what to do.
        """
        if not folder.is_dir():
            raise CaptureError(
                f"{folder} is not a folder: give the one that `tactilux hw capture` wrote",
                field="capture",
            )
        named = self._named(folder)
        own = read_json(folder / MANIFEST)
        listed = set(own.get("files", ()))
        written = {path.name for path in named.values()} <= listed and "photographs" in own
        if written and self.lens and own.get("dewarped"):
            raise CaptureError(
                f"{folder} was captured with its lens undone: leave --lens out", field="lens"
            )
        scale = SAVED_SCALE if written else self.full_scale
        photos = {path: self._photo(path) for path in named.values()}
        counts, lost = self._counts(photos, scale)
        if "dark" in named:
            check_dark(counts[named["dark"]], str(named["dark"].with_suffix("")))
        return photo_set({name: counts[path] for name, path in named.items()}, self.gamma, lost)

    def _named(self, folder: Path) -> dict[str, Path]:
        """Return the photographs of a folder by their names.

        Raises:
            CaptureError: two of one name, a name that is no photograph's, or none at all.
        """
        named: dict[str, Path] = {}
        for path in sorted(folder.iterdir()):
            name = path.stem.lower()
            # Hidden files are what systems keep for themselves.
            if path.name.startswith(".") or not NEARLY.fullmatch(name):
                continue
            match = NAME.fullmatch(name)
            if match is None or path.suffix.lower() not in SUFFIXES:
                raise CaptureError(
                    f"{path} is no photograph of a sweep, allowed: dark, all, fiber-00, fiber-01 "
                    f"and so on, each with {', '.join(SUFFIXES)}; save it anew, rename or remove "
                    "it",
                    field="capture",
                )
            if match[1] is not None:
                name = f"fiber-{int(match[1]):02d}"
                if int(match[1]) >= self.scene.lamp_count:
                    raise CaptureError(
                        f"{path} is of a fiber that {self.scene.name} does not have, allowed: 0 to "
                        f"{self.scene.lamp_count - 1}; number them from 0 on, or choose its scene",
                        field="capture",
                    )
            if name in named:
                raise CaptureError(
                    f"{named[name]} and {path.name} are two photographs of one name, allowed: one; "
                    "remove the other",
                    field="capture",
                )
            named[name] = path
        if not any(name.startswith("fiber") for name in named):
            raise CaptureError(
                f"{folder} holds no sweep: name its photographs fiber-00.png, fiber-01.png, ... or "
                "make them with `tactilux hw capture`",
                field="capture",
            )
        return named

    def _agree(self, scale: float, path: Path) -> None:
        """Refuse photographs of one camera whose full scales were found to differ."""
        self._found.setdefault(scale, path)
        if len(self._found) > 1:
            places = " and ".join(f"{at} for {one:g}" for one, at in self._found.items())
            raise CaptureError(
                f"the full scale could be taken for different ones, {places}, allowed: one for "
                "all photographs of a camera; give it with --full-scale",
                field="full_scale",
            )

    def _photo(self, path: Path) -> Photo:
        return read_photo(path, len(self.scene.palette.channels))

    def _counts(
        self, photos: dict[Path, Photo], stated: float | None
    ) -> tuple[dict[Path, Array], Array]:
        """Return counts of the scene's camera, and what compression left of error in them.

        ``stated`` is the full scale of ``photos``, None where it is to be found.
        """
        scale = full_scale(photos, stated)
        if stated is None:
            self._agree(scale, next(iter(photos)))
        if stated is None and any(photo.pixels.dtype != np.uint8 for photo in photos.values()):
            place = next(iter(photos)).parent if len(photos) > 1 else next(iter(photos))
            note(
                f"{place}: the full scale is taken to be {scale:g}, which all values fit into; "
                "--full-scale says otherwise."
            )
        check_exposure(photos, scale)
        counts = {}
        for path, photo in photos.items():
            seen = in_counts(photo, scale)
            counts[path] = seen if self._dewarp is None else self._dewarp(seen)
            check_photo(counts[path], self.scene.camera.rows, self.scene.camera.columns, str(path))
        lossy = np.broadcast_arrays(*(photo.compression for photo in photos.values()))
        most = np.max(lossy, axis=0)
        dark = [p.compression for path, p in photos.items() if path.stem.lower() == "dark"]
        return counts, np.hypot(most, dark[0] if dark else 0.0) * (FULL_SCALE / scale)
