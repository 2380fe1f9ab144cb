"""Moving pictures of the robot at work."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

SCENE = (480, 360)
"""Pixels of the scene, across and down."""
MARGIN = 12
EYE_WIDTH = 192
"""Pixels of the robot's own view, across."""


class Film:
    """Frames that show the scene, beside it what the robot saw and a few words.

    Args:
        rate: Frames per second.

    Attributes:
        frames: The frames so far.
    """

    def __init__(self, rate: int = 10) -> None:
        self.rate = rate
        self.frames: list[Image.Image] = []

    def take(
        self, scene: NDArray[np.uint8], seen: NDArray[np.float32], lines: Sequence[str]
    ) -> None:
        """Adds a frame.

        Args:
            scene: The scene from outside, (height, width, 3).
            seen: What the robot saw, (1, height, width), 0 to 1.
            lines: Words, a line each.
        """
        frame = Image.new("RGB", (SCENE[0] + EYE_WIDTH + 2 * MARGIN, SCENE[1]), "white")
        frame.paste(Image.fromarray(scene).resize(SCENE))
        eye = Image.fromarray((255 * seen[0]).round().astype(np.uint8))
        size = (EYE_WIDTH, round(EYE_WIDTH * eye.height / eye.width))
        left, top = SCENE[0] + MARGIN, MARGIN + 20
        draw = ImageDraw.Draw(frame)
        draw.text((left, MARGIN), "what the robot saw", "black", ImageFont.load_default(size=14))
        frame.paste(eye.resize(size, Image.Resampling.NEAREST), (left, top))
        draw.multiline_text(
            (left, top + size[1] + MARGIN),
            "\n".join(lines),
            "black",
            ImageFont.load_default(size=18),
            spacing=8,
        )
        self.frames.append(frame)

    def hold(self, seconds: float) -> None:
        """Repeats the last frame."""
        self.frames += self.frames[-1:] * round(seconds * self.rate)

    def write_gif(self, path: Path) -> None:
        """Writes an animation that repeats for ever."""
        # One palette for all: colours that change between frames flicker.
        palette = self.frames[len(self.frames) // 2].quantize(256)
        first, *rest = (
            frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in self.frames
        )
        first.save(path, save_all=True, append_images=rest, duration=1000 // self.rate, loop=0)

    def write_mp4(self, path: Path) -> bool:
        """Writes a video, if there is a program `ffmpeg`; says whether there is."""
        program = shutil.which("ffmpeg")
        if program is None:
            return False
        width, height = self.frames[0].size
        options = (
            f"-loglevel error -y -f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {self.rate}"
        )
        command = [program, *options.split(), "-i", "-", "-pix_fmt", "yuv420p", str(path)]
        pixels = b"".join(frame.tobytes() for frame in self.frames)
        return subprocess.run(command, input=pixels).returncode == 0
