"""Draws the pictures of `docs/nao_mugs.md`.

    python docs/robot_pictures.py scene docs/nao_mugs
    python docs/robot_pictures.py regimes docs/nao_mugs RUN RUN RUN

`scene` needs no training: the scene, a lift, and what the camera sees. `regimes` takes the log
folders of `bra fit` with the configurations high, low action and low.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from pictures import draw_heatmap
from PIL import Image, ImageDraw, ImageFont

from bra import Agent
from bra.callbacks.baseline import solve_reference
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


def draw_regimes(runs: list[Path]) -> Figure:
    """p(a|ω) of trained agents above, that of the Blahut-Arimoto optimum below."""
    figure = Figure(figsize=(9.6, 5.6), dpi=110, layout="constrained")
    axes = figure.subplots(2, len(runs))
    for (learnt, best), run in zip(axes.T, runs, strict=True):
        agent = Agent.load_from_checkpoint(run / "checkpoints" / "last.ckpt")
        reference = solve_reference(agent)
        optimum = reference.optimum or reference.without_noise
        names = (agent.task.state_names, agent.task.action_names)
        draw_heatmap(learnt, agent.behaviour(), *names)
        prices = f"β₁ = {agent.beta_perception:g}, β₂ = {agent.beta_action:g}"
        learnt.set_title(f"{prices}\nagent, J = {agent.evaluate().objective:.4f}", fontsize=11)
        draw_heatmap(best, optimum.action_given_state, *names)
        best.set_title(f"optimum, J = {optimum.objective:.4f}", fontsize=11)
    return figure


def main() -> None:
    """Draws what is asked for."""
    what, folder, *runs = sys.argv[1:]
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    if what == "regimes":
        draw_regimes([Path(run) for run in runs]).savefig(target / "regimes.png")
        return
    draw_lift().save(target / "lift.png", optimize=True)
    draw_camera().savefig(target / "camera.png")


if __name__ == "__main__":
    main()
