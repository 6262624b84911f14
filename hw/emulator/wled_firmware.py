"""As much of WLED as a driver of single LEDs meets, with the states in which it shows less.

Written from WLED's documentation and from what its source does with ``i``, grouping and limits.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from hw.leds.board import Levels, dark

MISSING = "missing"
"""Stands for a field that a version does not have."""
LED_MILLIAMPERES = 55
"""What WLED takes an LED to draw when white, unless it is told otherwise."""
OWN_MILLIAMPERES = 100
EFFECT = (255, 160, 0)
"""What a segment shows that nobody has set."""
LIVE = (40, 0, 40)
"""What another source sends."""

SECOND = {
    "id": 1, "start": 12, "stop": 20, "len": 8, "grp": 1, "spc": 0, "of": 0, "on": True,
    "frz": False, "bri": 255, "rev": False, "mi": False,
}  # fmt: skip
WLED_STATES: dict[str, dict[str, object]] = {
    "factory": {"cfg.light.gc.col": 2.8, "cfg.hw.led.maxpwr": 850},
    "limiter": {"cfg.hw.led.maxpwr": 250},
    "live": {"info.live": True, "info.lm": "E1.31", "info.lip": "192.168.1.9"},
    "override": {
        "info.live": True, "info.lm": "E1.31", "info.lip": "192.168.1.9", "state.lor": 1,
    },
    "gamma": {"cfg.light.gc.col": 2.8},
    "brightness-factor": {"cfg.light.scale-bri": 50},
    "white-balance": {"cfg.hw.led.cct": True},
    "automatic-white": {"info.leds.rgbw": True, "cfg.hw.led.ins.0.rgbwm": 2},
    "off": {"state.on": False},
    "dim": {"state.bri": 128},
    "transition": {"state.transition": 7},
    "nightlight": {"state.nl.on": True},
    "playlist": {"state.pl": 1},
    "ledmap": {"state.ledmap": 1},
    "panel": {"info.leds.matrix": {"w": 5, "h": 4}},
    "white-leds": {"info.leds.lc": 2},
    "short-segment": {"state.seg.0.stop": 10, "state.seg.0.len": 10},
    "late-segment": {"state.seg.0.start": 1},
    "second-segment": {"state.seg.1": SECOND},
    "no-segment": {"state.seg": []},
    "segment-off": {"state.seg.0.on": False},
    "segment-dim": {"state.seg.0.bri": 64},
    "thawed": {"state.seg.0.frz": False},
    "grouped": {"state.seg.0.grp": 2},
    "spaced": {"state.seg.0.spc": 1},
    "offset": {"state.seg.0.of": 3},
    "reversed": {"state.seg.0.rev": True},
    "mirrored": {"state.seg.0.mi": True},
    "old": {
        "info.ver": "0.9.1", "state.seg.0.frz": MISSING, "state.seg.0.grp": MISSING,
        "state.seg.0.spc": MISSING, "state.seg.0.of": MISSING, "state.seg.0.mi": MISSING,
        "state.pl": MISSING, "state.lor": MISSING, "state.nl": MISSING, "cfg": MISSING,
    },
    "bare": {
        "state.ledmap": MISSING, "state.nl": MISSING, "state.pl": MISSING, "state.lor": MISSING,
        "info.live": MISSING, "info.leds.pwr": MISSING, "info.leds.maxpwr": MISSING,
        "info.leds.lc": MISSING, "info.leds.rgbw": MISSING, "state.seg.0.len": MISSING,
    },
    "pin": {"cfg": MISSING},
}  # fmt: skip
"""By its name, what a state holds WLED to, whatever it is told; a dot before each part of a path.

``factory`` is as delivered, ``override`` and ``bare`` (a version with few fields) show all light.
"""


class WledFirmware:
    """WLED that starts dark, with one segment of all ``leds`` and the fields that are ``held``."""

    def __init__(self, leds: int, held: Mapping[str, object] | None = None) -> None:
        self._leds, self._held = leds, held or {}
        self._buffer = b""
        self._pixels: dict[int, Levels] = {0: dark(leds)}
        segment = {**SECOND, "id": 0, "start": 0, "stop": leds, "len": leds}
        self._tree: dict[str, Any] = {
            "state": {
                "on": False, "bri": 128, "transition": 7, "ps": -1, "pl": -1, "ledmap": 0,
                "nl": {"on": False, "dur": 60}, "udpn": {"send": False, "recv": True}, "lor": 0,
                "mainseg": 0, "seg": [segment],
            },
            "info": {
                "ver": "0.14.0", "name": "WLED", "live": False, "lm": "", "lip": "",
                "leds": {"count": leds, "pwr": 0, "maxpwr": 0, "lc": 1, "rgbw": False},
            },
            "cfg": {
                "light": {"scale-bri": 100, "gc": {"bri": 1, "col": 1, "val": 2.8}},
                "hw": {"led": {"maxpwr": 0, "cct": False, "rgbwm": 255, "ins": [{"rgbwm": 0}]}},
            },
        }  # fmt: skip
        self._show()

    def take(self, content: bytes, _now: float) -> bytes:
        """Obey every whole JSON object; answer those that ask for it with ``v``, and ``l``."""
        *lines, self._buffer = (self._buffer + content).split(b"\n")
        answer = b""
        for line in lines:
            if line == b"l":
                answer += json.dumps(self._packed()).encode() + b"\r\n"
                continue
            try:
                request = json.loads(line)
            except ValueError:
                continue
            self._obey(request)
            if request.get("v"):
                answer += json.dumps({name: self.page(name) for name in ("state", "info")}).encode()
                answer += b"\r\n"
        return answer

    def page(self, name: str) -> object:
        """Return what ``/json/<name>`` answers, None where there is no such page."""
        return self._without_missing(copy.deepcopy(self._tree.get(name)), name)

    def _obey(self, request: dict[str, Any]) -> None:
        state = self._tree["state"]
        was_on = state["on"]
        state.update({key: request[key] for key in ("on", "bri", "transition") if key in request})
        state["nl"].update(request.get("nl", {}))
        if state["on"] and not was_on:
            for segment in state["seg"]:
                segment["frz"] = False
        wanted = request.get("seg", {})
        for segment in state["seg"]:
            if segment["id"] == wanted.get("id"):
                segment.update({key: wanted[key] for key in ("on", "bri") if key in wanted})
                if "i" in wanted:
                    self._set(segment, wanted["i"])
        self._show()

    def _set(self, segment: dict[str, Any], items: list[Any]) -> None:
        """Set single LEDs: a number is a place, two are a range, a text is a color."""
        pixels = self._pixels[segment["id"]]
        if not segment["frz"]:
            segment["frz"], pixels[:] = True, 0
        places: list[int] = []
        place = 0
        for item in items:
            if isinstance(item, int):
                places.append(item)
                continue
            place, end = places[0] if places else place, places[1] if len(places) > 1 else 0
            end = max(end, place + 1)
            pixels[place:end] = list(bytes.fromhex(item))
            place, places = end, []

    def _show(self) -> None:
        """Hold what the state holds, then find what the LEDs show."""
        for path, value in self._held.items():
            if value != MISSING:
                self._hold(path.split("."), value)
        state, info = self._tree["state"], self._tree["info"]
        self.shown = dark(self._leds)
        if info["live"] and not state["lor"]:
            self.shown[:] = LIVE
        elif state["on"]:
            bright = state["bri"] / 255 * self._tree["cfg"]["light"]["scale-bri"] / 100
            self.shown = (self._limited(bright) * self._frame()).astype(np.uint8)

    def _hold(self, path: list[str], value: object) -> None:
        place: Any = self._tree
        for name in path[:-1]:
            place = place[int(name)] if isinstance(place, list) else place[name]
        if not isinstance(place, list):
            place[path[-1]] = copy.deepcopy(value)
        elif len(place) == int(path[-1]):
            place.append(copy.deepcopy(value))
            self._pixels[len(place) - 1] = dark(self._leds)

    def _frame(self) -> Levels:
        """Return the LEDs before the brightness of all."""
        frame = dark(self._leds)
        for segment in self._tree["state"]["seg"]:
            length = segment["stop"] - segment["start"]
            pixels = self._pixels[segment["id"]][:length].astype(np.float64)
            if not segment["frz"]:
                pixels[:] = EFFECT
            pixels = 255 * (pixels / 255) ** self._tree["cfg"]["light"]["gc"]["col"]
            opacity = segment["bri"] / 255 * segment["on"]
            for number, color in enumerate(pixels):
                for place in self._places(segment, number, length):
                    frame[place] = np.rint(opacity * color)
        return frame

    def _places(self, segment: dict[str, Any], number: int, length: int) -> list[int]:
        """Return the LEDs that show the pixel ``number`` of a segment."""
        group, space = segment["grp"], segment["spc"]
        own = [place for place in range(number * (group + space), number * (group + space) + group)]
        if segment["mi"]:
            own = [place for place in own if place < (length + 1) // 2]
            own += [length - 1 - place for place in own]
        if segment["rev"]:
            own = [length - 1 - place for place in own]
        return [segment["start"] + (place + segment["of"]) % length for place in own
                if 0 <= place < length]  # fmt: skip

    def _limited(self, bright: float) -> float:
        """Return the brightness that the limiter leaves, and say what is drawn."""
        limit, leds = self._tree["cfg"]["hw"]["led"]["maxpwr"], self._tree["info"]["leds"]
        if not limit:
            return bright
        idle = OWN_MILLIAMPERES + self._leds
        wanted = bright * self._frame().sum() / (3 * 255) * LED_MILLIAMPERES
        scale = min(1.0, (limit - idle) / wanted) if wanted else 1.0
        counted = OWN_MILLIAMPERES if self._tree["info"]["ver"].startswith("0.15.") else idle
        leds.update(maxpwr=limit, pwr=int(scale * wanted + counted))
        return bright * scale

    def _packed(self) -> list[int]:
        """Return what is held for each LED, with gamma but before the brightness of all."""
        return [(red << 16) + (green << 8) + blue for red, green, blue in self._frame().tolist()]

    def _without_missing(self, found: Any, root: str) -> Any:
        """Return a page without the fields that the version does not have."""
        for path, value in self._held.items():
            names = path.split(".")
            if value != MISSING or names[0] != root:
                continue
            if len(names) == 1:
                return None
            place = found
            for name in names[1:-1]:
                place = place[int(name)] if isinstance(place, list) else place[name]
            place.pop(names[-1], None)
        return found
