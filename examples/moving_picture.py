"""The moving picture of the README: the finger bends, under the baseline and the design found.

``python examples/moving_picture.py docs/bending.gif`` draws both with the preview, the
skin from outside with the tip up, a pyramid pressed in at every site.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import tactilux
from optimize.report import encode_srgb

WIDTH, HEIGHT, HEAD = 180, 300, 42
FRAMES, MILLISECONDS, PAUSE = 13, 120, 1200
COLORS = 256


def main(path: Path) -> None:
    """Write the picture."""
    scene = tactilux.load_scene("finger20")
    found = tactilux.explore(scene)
    stages = {"baseline": found.stages[0], "found in seconds": found.stages[-1]}
    font = ImageFont.load_default(15)
    frames = []
    with tactilux.Preview(scene) as preview:
        for degrees in np.linspace(0.0, 90.0, FRAMES):
            frame = Image.new("RGB", (2 * WIDTH, HEIGHT + HEAD), "white")
            draw = ImageDraw.Draw(frame)
            for side, (title, stage) in enumerate(stages.items()):
                design, exposure = stage.design, stage.settings.exposure
                seen = preview.picture(design.phi, design.power, np.radians(degrees), WIDTH, HEIGHT)
                shown = encode_srgb(seen.astype(float) * exposure / 255.0)
                frame.paste(Image.fromarray(shown), (side * WIDTH, HEAD))
                score = f"S = {stage.rating.score:.0f}"
                draw.text((side * WIDTH + 8, 3), f"{title}, {score}", fill="black", font=font)
            draw.text((8, 22), f"bend {degrees:.0f}°", fill="#5b616b", font=font)
            frames.append(frame)
    # One palette for all, so that colors do not flicker.
    palette = Image.new("RGB", (2 * WIDTH, 3 * (HEIGHT + HEAD)))
    for row, frame in enumerate((frames[0], frames[FRAMES // 2], frames[-1])):
        palette.paste(frame, (0, row * (HEIGHT + HEAD)))
    table = palette.quantize(COLORS)
    there = [frame.quantize(palette=table) for frame in frames]
    duration = [PAUSE, *[MILLISECONDS] * (FRAMES - 2), PAUSE]
    there[0].save(path, save_all=True, append_images=there[1:], duration=duration, loop=0)
    print(path, path.stat().st_size)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
