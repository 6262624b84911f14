"""Options that several commands of the rig share; each is declared here alone."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from hw.leds import ProtocolName

if TYPE_CHECKING:
    from hw.camera.photo_reader import PhotoReader
    from hw.camera.photo_set import PhotoSet
    from hw.leds.fiber_lights import FiberLights
    from render.scene import Scene

SceneOption = Annotated[str, Option("--scene", help="Name of a shipped scene, or a TOML file.")]
Lens = Annotated[
    Path | None,
    Option(help="File of the camera's lens (default: photographs are the scene's camera's)."),
]
Calibrated = Annotated[
    Path | None,
    Option("--calibration", help="calibration.json (default: one beside the design or scene)."),
]
Port = Annotated[
    str | None, Option(help="Serial port (default: the only one; see `tactilux hw ports`).")
]
SpokenProtocol = Annotated[ProtocolName, Option(help="What the LED board speaks.")]
Baud = Annotated[int, Option(min=1200, help="Bits per second.")]


@dataclass(frozen=True)
class Wiring:
    """How the lights are connected, as the options of the command line say."""

    port: Port = None
    protocol: SpokenProtocol = ProtocolName.LINES
    baud: Baud = 115200
    leds: Annotated[
        str | None, Option(help="LED of each fiber, like 0,1,2 (default: in their order).")
    ] = None
    order: Annotated[str, Option(help="How the LEDs' channels are wired: rgb, grb, ...")] = "rgb"
    limit_ma: Annotated[float, Option(min=1.0, help="Current that the supply may give, in mA.")] = (
        500.0
    )
    scale: Annotated[float, Option(min=0.0, max=1.0, help="Factor on all powers.")] = 1.0

    def lights(self, fibers: int, colors: int = 3) -> FiberLights:
        """Open the board for ``fibers`` fibers of so many LED colors."""
        from hw.leds.channels import ChannelMap, PowerLimits
        from hw.leds.fiber_lights import FiberLights
        from hw.leds.ports import open_board, the_port

        channels = ChannelMap.parse(self.leds, fibers, self.order, colors)
        port = the_port(self.port)
        connect = functools.partial(
            open_board, port, self.protocol, leds=channels.needed, baud=self.baud
        )
        return FiberLights(connect, channels, PowerLimits(total_milliamperes=self.limit_ma))


@dataclass(frozen=True)
class Photographs:
    """How photographs were taken, as the options of the command line say."""

    lens: Lens = None
    full_scale: Annotated[
        float | None,
        Option(min=1e-6, help="Value at which the camera saturates, like 4095 (default: found)."),
    ] = None
    gamma: Annotated[
        float, Option(min=0.2, max=5.0, help="Gamma of the photographs (1: linear).")
    ] = 1.0
    noise: Annotated[
        float, Option(min=0.01, help="Noise of one pixel of the photographs, in counts of 255.")
    ] = 2.55

    def reader(self, scene: Scene) -> PhotoReader:
        """Return what reads photographs of the camera of ``scene``."""
        from hw.camera.photo_reader import PhotoReader

        return PhotoReader(scene, self.lens, self.full_scale, self.gamma)

    def seen(self, scene: Scene, capture: Path) -> PhotoSet:
        """Return one photograph of all fibers, or the sweep in a folder."""
        reader = self.reader(scene)
        return reader.sweep(capture) if capture.is_dir() else reader.together(capture)


@dataclass(frozen=True)
class Renders:
    """The renders that correct a calibration, as the options of the command line say."""

    materials: Annotated[
        int | None,
        Option(
            min=1,
            max=64,
            help="Materials rendered once for all rigs of a design, and kept "
            "(default: 32 behind a diffuser, 16 on a clear pad).",
        ),
    ] = None
    samples: Annotated[
        int, Option(min=0, help="Light paths per fiber and cell of all renders (0: no renders).")
    ] = 1000


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of each dataclass among its parameters in that one's place."""
    signature = inspect.signature(command, eval_str=True)
    groups: dict[str, tuple[type, list[inspect.Parameter]]] = {}
    parameters: list[inspect.Parameter] = []
    for name, parameter in signature.parameters.items():
        kind = parameter.annotation
        options = [parameter]
        if is_dataclass(kind) and isinstance(kind, type):
            declared = inspect.signature(kind, eval_str=True).parameters.values()
            options = [option.replace(kind=inspect.Parameter.KEYWORD_ONLY) for option in declared]
            groups[name] = kind, options
        parameters += options

    @functools.wraps(command)
    def run(**values: Any) -> None:
        for name, (kind, options) in groups.items():
            values[name] = kind(**{option.name: values.pop(option.name) for option in options})
        command(**values)

    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return run
