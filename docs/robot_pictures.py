"""Draws the pictures of `docs/nao_mugs.md`.

    python docs/robot_pictures.py docs/nao_mugs

A lift, and what the camera sees. `regimes.png` is the second `behaviour.png` of
`bra reproduce mugs-trained`.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageDraw, ImageFont

from bra.tasks.nao_mugs import MUGS, Pose
from bra.tasks.nao_mugs.camera import Camera, Studio
from bra.tasks.nao_mugs.jitter import Jitter
from bra.tasks.nao_mugs.lift import lift
from bra.tasks.nao_mugs.scene import Scene

BOTH_HANDS = 3
MOMENTS = {1: "at rest", 27: "before the handles", 50: "jaws closed", 76: "lifted and held"}
"""Looks of a spectator, 30 a second."""


def draw_lift() -> Image.Image:
    """The two-handled mug, lifted with both hands: four moments side by side."""
    moments: list[np.ndarray] = []
    font = ImageFont.load_default(size=22)
    with Scene() as scene:
        scene.place(MUGS[3], Pose())
        looks = 0

        def watch() -> None:
            nonlocal looks
            looks += 1
            if looks in MOMENTS:
                picture = Image.fromarray(scene.window(480, 360))
                ImageDraw.Draw(picture).text((12, 8), MOMENTS[looks], "black", font)
                moments.append(np.asarray(picture))

        lift(scene, BOTH_HANDS, Pose(), watch)
    return Image.fromarray(np.hstack(moments))


def draw_camera() -> Figure:
    """The four mugs: large, as the agent sees them, and three jittered frames of each."""
    large, small = Studio(Camera(320, 240)), Studio()
    jitter = Jitter(0.01, 10.0, 0.3)
    numbers = np.random.default_rng(1).random((3, Jitter.NUMBERS))
    titles = ["320 × 240", "16 × 12 grey, the signal ξ", "with ±1 cm, ±10° and light", "", ""]
    figure = Figure(figsize=(12.0, 7.4), dpi=100, layout="constrained")
    axes = figure.subplots(len(MUGS), 5)
    for row, kind in zip(axes, MUGS, strict=True):
        row[0].imshow(large.rgb(kind, Pose()))
        row[0].set_ylabel(kind.name, rotation=0, labelpad=18, va="center", fontsize=14)
        row[1].imshow(small.grey(kind, Pose())[0], cmap="gray", vmin=0, vmax=1)
        for cell, one in zip(row[2:], numbers, strict=True):
            frame = small.grey(kind, jitter.pose(one), jitter.lamp(one))
            cell.imshow(frame[0], cmap="gray", vmin=0, vmax=1)
    for row in axes:
        for cell in row:
            cell.set_xticks([])
            cell.set_yticks([])
    for cell, title in zip(axes[0], titles, strict=True):
        cell.set_title(title, fontsize=11, loc="left")
    return figure


def main() -> None:
    """Draws what is asked for."""
    target = Path(sys.argv[1])
    target.mkdir(parents=True, exist_ok=True)
    draw_lift().save(target / "lift.png", optimize=True)
    draw_camera().savefig(target / "camera.png")


if __name__ == "__main__":
    main()
