"""Plugins for Mitsuba: ``bdpt`` and ``pssmlt``, ``fiber`` and ``measured_light``, ``fisheye``."""

from __future__ import annotations

import functools
import inspect
import re
import sys
from collections.abc import Callable
from typing import Any

from render import errors
from render.errors import RenderError, TactiluxError
from render.steady_registry import steady_registry

_registered: set[str] = set()


def register() -> None:
    """Register the plugins for the variant that is set, once per variant.

    The classes derive from types of the variant that is set, so their modules are loaded anew.
    """
    import mitsuba as mi

    variant = str(mi.variant())
    if variant in _registered:
        return
    names = ("profile_emitter", "fiber_emitter", "measured_emitter", "bidirectional", "fisheye")
    for name in names:
        sys.modules.pop(f"render.integrators.{name}", None)
    from render.integrators.bidirectional import BDPT, PSSMLT
    from render.integrators.fiber_emitter import FiberEmitter
    from render.integrators.fisheye import FisheyeCamera
    from render.integrators.measured_emitter import MeasuredEmitter

    mi.register_emitter("fiber", FiberEmitter)
    mi.register_emitter("measured_light", MeasuredEmitter)
    mi.register_sensor("fisheye", FisheyeCamera)
    mi.register_integrator("pssmlt", PSSMLT)
    mi.register_integrator("bdpt", BDPT)
    _registered.add(variant)
    _pass_errors_on(mi)


def _pass_errors_on(mi: Any) -> None:
    """Let Mitsuba raise our typed errors as they are.

    Dr.Jit wraps every exception of an integrator that is written in Python in a RuntimeError
    without the reason, and what loads scenes puts a traceback in its own.
    """
    plain = mi.render
    if hasattr(plain, "__wrapped__"):
        return
    for name in ("load_dict", "load_file", "load_string"):
        setattr(mi, name, _loading(getattr(mi, name)))

    signature = inspect.signature(plain)

    @functools.wraps(plain)
    def render(*arguments: Any, **named: Any) -> Any:
        given = signature.bind_partial(*arguments, **named).arguments
        scene = given.get("scene")
        integrator: Any = given.get("integrator")
        if integrator is None and scene is not None:
            integrator = scene.integrator()
        if scene is not None and hasattr(integrator, "refuse_gradients"):
            # Dr.Jit hides gradients from integrators, and asks for them only afterwards.
            for parameters in (mi.traverse(scene), given.get("params")):
                # Mitsuba takes no other parameters, and says so.
                if isinstance(parameters, mi.SceneParameters):
                    integrator.refuse_gradients(parameters)
        try:
            with steady_registry():
                return plain(*arguments, **named)
        except RuntimeError as error:
            if isinstance(error.__cause__, RenderError):
                raise error.__cause__ from None
            raise

    mi.render = render


def _loading(plain: Callable[..., Any]) -> Callable[..., Any]:
    """Return a loader of scenes that raises a plugin's typed error, with the place of the plugin.

    Mitsuba knows no more of that error than its text.
    """

    @functools.wraps(plain)
    def load(*arguments: Any, **named: Any) -> Any:
        try:
            return plain(*arguments, **named)
        except RuntimeError as error:
            found = re.search(r"^(?:[\w.]+\.)?(\w+Error): (.+)", str(error), re.MULTILINE)
            kind = getattr(errors, found[1], None) if found else None
            if found is None or not (isinstance(kind, type) and issubclass(kind, TactiluxError)):
                raise
            place = re.search(r'dictionary node "([^"]+)"', str(error))
            raise kind(f"{place[1]}: {found[2]}" if place else found[2]) from None

    return load
