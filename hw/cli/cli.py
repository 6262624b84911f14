"""The whole program: the commands of `optimize.cli.cli`, and those that need a rig.

This module is the console script, because ``hw`` may import ``optimize`` and not the other way
round. Only options are declared here; the work is in ``hw/commands``, imported when it runs.
"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from optimize.cli.cli import Bend, Design, DesignFile, Json, Model, Scene, Seed, app, main

rig = typer.Typer(
    name="hw",
    help="Drive LEDs and camera of a rig, calibrate the scene to it, or play with an emulated one.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.add_typer(rig)


class Speech(StrEnum):
    """What the LED board speaks."""

    LINES = "lines"
    WLED = "wled"
    ADALIGHT = "adalight"


Port = Annotated[
    str | None, typer.Option(help="Serial port (default: the only one; see `tactilux hw ports`).")
]
Protocol = Annotated[Speech, typer.Option(help="What the LED board speaks.")]
Baud = Annotated[int, typer.Option(min=1200, help="Bits per second.")]
Leds = Annotated[
    str | None, typer.Option(help="LED of each fiber, like 0,1,2 (default: in their order).")
]
Order = Annotated[str, typer.Option(help="How the LEDs' channels are wired: rgb, grb, ...")]
Limit = Annotated[float, typer.Option(min=1.0, help="Current that the supply may give, in mA.")]
Scale = Annotated[float, typer.Option(min=0.0, max=1.0, help="Factor on all powers.")]
SceneOption = Annotated[str, typer.Option(help="Name of a shipped scene, or a TOML file.")]
Lens = Annotated[
    Path | None, typer.Option(help="Fisheye lens, a TOML file (default: photographs are pinhole).")
]
Gamma = Annotated[
    float, typer.Option(min=0.2, max=5.0, help="Gamma of the photographs (1: linear).")
]
Noise = Annotated[
    float, typer.Option(min=0.01, help="Noise of one pixel of the photographs, in counts.")
]
Samples = Annotated[
    int,
    typer.Option(min=0, help="Light paths per fiber and cell of all renders (0: no renders)."),
]
Materials = Annotated[
    int,
    typer.Option(min=1, max=64, help="Materials rendered once for all rigs of a design, and kept."),
]


@rig.command()
def ports(json: Json = False) -> None:
    """List the serial ports that LED boards may be on."""
    from hw.cli import lights as command

    command.ports(as_json=json)


@rig.command("set")
def set_lights(
    design: DesignFile,
    port: Port = None,
    protocol: Protocol = Speech.LINES,
    baud: Baud = 115200,
    leds: Leds = None,
    order: Order = "rgb",
    limit_ma: Limit = 500.0,
    scale: Scale = 1.0,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="How long (default: until Ctrl-C).")
    ] = None,
) -> None:
    """Light the fibers as a design says; off when the command ends."""
    from hw.cli import lights as command
    from hw.cli.wiring import Wiring

    wiring = Wiring(port, protocol.value, baud, leds, order, limit_ma, scale)
    command.set_lights(design, wiring, seconds=seconds)


@rig.command()
def sweep(
    design: DesignFile,
    port: Port = None,
    protocol: Protocol = Speech.LINES,
    baud: Baud = 115200,
    leds: Leds = None,
    order: Order = "rgb",
    limit_ma: Limit = 500.0,
    scale: Scale = 1.0,
    seconds: Annotated[float, typer.Option(min=0.0, help="How long each fiber is lit.")] = 0.5,
) -> None:
    """Light one fiber of a design after the other."""
    from hw.cli import lights as command
    from hw.cli.wiring import Wiring

    wiring = Wiring(port, protocol.value, baud, leds, order, limit_ma, scale)
    command.sweep_lights(design, wiring, seconds=seconds)


@rig.command()
def off(
    port: Port = None,
    protocol: Protocol = Speech.LINES,
    baud: Baud = 115200,
    count: Annotated[
        int | None, typer.Option(min=1, max=65536, help="LEDs of a board that cannot say (64).")
    ] = None,
) -> None:
    """Switch all LEDs of a board off."""
    from hw.cli import lights as command

    command.off(port, protocol.value, baud, count=count)


@rig.command()
def capture(
    design: DesignFile,
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    scene: SceneOption = "finger20",
    camera: Annotated[int, typer.Option(min=0, help="Number of the camera.")] = 0,
    lens: Lens = None,
    exposure: Annotated[float | None, typer.Option(help="In the driver's own unit.")] = None,
    gain: Annotated[float | None, typer.Option(help="In the driver's own unit.")] = None,
    white_balance: Annotated[float | None, typer.Option(help="In kelvin.")] = None,
    frames: Annotated[int, typer.Option(min=1, help="Photographs that are averaged.")] = 4,
    white: Annotated[
        float | None,
        typer.Option(min=0.0, max=1.0, help="Light all three channels with this power."),
    ] = None,
    port: Port = None,
    protocol: Protocol = Speech.LINES,
    baud: Baud = 115200,
    leds: Leds = None,
    order: Order = "rgb",
    limit_ma: Limit = 500.0,
    scale: Scale = 1.0,
) -> None:
    """Photograph the dark, every fiber alone, and all together into a folder."""
    from hw.cli import capture as command
    from hw.cli.wiring import Wiring

    command.run(
        scene,
        design,
        command.Shot(camera, lens, exposure, gain, white_balance, frames),
        Wiring(port, protocol.value, baud, leds, order, limit_ma, scale),
        out=out,
        white=white,
    )


@rig.command()
def calibrate(
    flat: Annotated[Path, typer.Option(help="Folder of the sweep with the flat pad.")],
    bent: Annotated[Path, typer.Option(help="Folder of the sweep with the bent pad.")],
    bend: Annotated[
        float, typer.Option(min=1.0, max=180.0, help="Total angle of the bent pad in degrees.")
    ] = 90.0,
    linearity: Annotated[
        Path | None, typer.Option(help="Folder of a sweep with all fibers together as well.")
    ] = None,
    scene: SceneOption = "finger20",
    design: Design = None,
    model: Model = None,
    out: Annotated[
        Path | None, typer.Option(help="Result directory (default: runs/<scene>-calibrate).")
    ] = None,
    gamma: Gamma = 1.0,
    noise: Noise = 2.55,
    materials: Materials = 32,
    samples: Samples = 1000,
    json: Json = False,
) -> None:
    """Fit the scene's material, powers and gains to photographs of single fibers."""
    from hw.cli import calibrate as command

    command.run(
        scene,
        flat=flat,
        bent=bent,
        bend=bend,
        additive=linearity,
        design=design,
        model=model,
        out=out,
        gamma=gamma,
        noise=noise,
        materials=materials,
        samples=samples,
        as_json=json,
    )


@rig.command()
def linearity(
    sweep: Annotated[Path, typer.Argument(help="Folder of a sweep with all fibers together.")],
    scene: SceneOption = "finger20",
    gamma: Gamma = 1.0,
    noise: Noise = 2.55,
    json: Json = False,
) -> None:
    """Test whether light adds up in the photographs of a sweep."""
    from hw.cli import linearity as command

    command.run(scene, sweep, gamma=gamma, noise=noise, as_json=json)


@rig.command()
def demo(
    scene: SceneOption = "finger20",
    out: Annotated[
        Path | None, typer.Option(help="Result directory (default: runs/<scene>-demo).")
    ] = None,
    model: Model = None,
    seed: Seed = 0,
    rig_samples: Annotated[
        int, typer.Option(min=1, help="Light paths per fiber and cell of rendered photographs.")
    ] = 2000,
    materials: Materials = 32,
    samples: Samples = 1000,
    rays: Annotated[
        int, typer.Option(min=2000, help="Light paths of photographs that are not rendered.")
    ] = 360_000,
    calibrate: Annotated[
        bool, typer.Option(help="Also calibrate, on rendered photographs: the long part.")
    ] = True,
    json: Json = False,
) -> None:
    """Run set, sweep, check and calibrate on an emulated rig with secret true values."""
    from hw.cli import demo as command

    command.run(
        scene,
        out=out,
        model=model,
        seed=seed,
        rig_samples=rig_samples,
        materials=materials,
        samples=samples,
        rays=rays,
        calibrate=calibrate,
        as_json=json,
    )


@rig.command()
def recall(
    scene: SceneOption = "finger20",
    model: Model = None,
    rigs: Annotated[int, typer.Option(min=1, help="Number of random rigs.")] = 500,
    seed: Seed = 0,
    truth: Annotated[
        Path | None, typer.Option(help="Transport table that stands for the true light.")
    ] = None,
    json: Json = False,
) -> None:
    """Measure how many single-fiber faults the check finds on random rigs."""
    from hw.cli import recall as command

    command.run(scene, model=model, rigs=rigs, seed=seed, truth=truth, as_json=json)


@rig.command()
def recovery(
    scene: SceneOption = "finger20",
    model: Model = None,
    rigs: Annotated[int, typer.Option(min=1, help="Number of random rigs.")] = 5,
    seed: Annotated[int, typer.Option(min=0, help="Of the first rig; the others follow.")] = 0,
    rig_samples: Annotated[
        int, typer.Option(min=1, help="Light paths per fiber and cell of the photographs.")
    ] = 8000,
    materials: Materials = 32,
    samples: Samples = 1000,
    json: Json = False,
) -> None:
    """Measure how well calibration recovers random rigs from rendered photographs."""
    from hw.cli import recovery as command

    command.run(
        scene,
        model=model,
        rigs=rigs,
        seed=seed,
        rig_samples=rig_samples,
        materials=materials,
        samples=samples,
        as_json=json,
    )


@app.command()
def check(
    scene: Scene = "finger20",
    design: Design = None,
    capture: Annotated[
        Path | None, typer.Option(help="Photograph with all fibers lit, or the folder of a sweep.")
    ] = None,
    camera: Annotated[int | None, typer.Option(min=0, help="Number of a live camera.")] = None,
    lens: Lens = None,
    rig: Annotated[
        Path | None, typer.Option(help="Record of the healthy rig, for finer checks.")
    ] = None,
    commission: Annotated[
        Path | None, typer.Option(help="Write such a record from this sweep.")
    ] = None,
    bend: Bend = 0.0,
    gamma: Gamma = 1.0,
    noise: Noise = 2.55,
    model: Model = None,
    port: Port = None,
    protocol: Protocol = Speech.LINES,
    baud: Baud = 115200,
    leds: Leds = None,
    order: Order = "rgb",
    limit_ma: Limit = 500.0,
    scale: Scale = 1.0,
    json: Json = False,
) -> None:
    """Say whether the rig looks as designed: exit code 0 if so, 1 with a fault."""
    from hw.cli import check as command
    from hw.cli.wiring import Wiring

    command.run(
        scene,
        design=design,
        model=model,
        capture=capture,
        camera=camera,
        lens=lens,
        wiring=Wiring(port, protocol.value, baud, leds, order, limit_ma, scale),
        bend=bend,
        rig=rig,
        commissioned=commission,
        gamma=gamma,
        noise=noise,
        as_json=json,
    )


__all__ = ["Model", "Scene", "Seed", "app", "main"]

if __name__ == "__main__":
    main()
