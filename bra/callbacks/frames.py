"""What the agent sees, and what it makes of it."""

from collections.abc import Sequence

import lightning.pytorch as pl
import numpy as np
import torch
from gymnasium.spaces import Box
from PIL import Image, ImageDraw
from torch import Tensor

from bra.agent import Agent
from bra.callbacks.pictures import log_pictures
from bra.callbacks.schedule import Monitor
from bra.pictures import legible
from bra.randomness.generators import counted, counted_generator
from bra.tasks import FiniteStateTask, World
from bra.tasks.observations import grey_levels, has_grey_levels

PICTURES = 16
COLUMNS = 4
MARGIN = 4
"""Pixels between the pictures of the grid."""
TILE_WIDTH = 160
"""Pixels of one frame in the grid, across."""
CAPTION_HEIGHT, LETTERS = 24, 13


class ObservationFrames(Monitor):
    """Shows image observations in a grid, with the agent's percept and action under each.

    For tasks whose observations are a bounded `Box` of shape (1 or 3, height, width), the same
    range for all pixels, which is shown from black to white; others have no pictures. Picture, for
    every logger that takes some: `observations/percept_and_action`, of some 16 signals that no
    update sees, the same at every look; each caption says state, percept, action and utility.

    Args:
        every_n_updates: Updates between two pictures; None is some eighth of the run.
    """

    def __init__(self, every_n_updates: int | None = None) -> None:
        super().__init__(every_n_updates)

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Draws the grid."""
        if shows_images(agent):
            log_pictures(
                trainer,
                "observations",
                agent.updates,
                lambda: {"percept_and_action": frame_grid(agent)},
            )


def shows_images(agent: Agent) -> bool:
    """Whether an agent's observations can be shown as pictures."""
    space = agent.task.observation_space
    return (
        isinstance(space, Box)
        and len(space.shape) == 3
        and space.shape[0] in (1, 3)
        and has_grey_levels(space)
    )


def frame_grid(agent: Agent) -> Image.Image:
    """Signals of all states with what the agent does.

    Args:
        agent: One that `shows_images`.
    """
    world = _example_worlds(agent)
    with counted(agent.seed, agent.updates, "frames", agent.device):
        percepts, actions = agent.act(world.observation.to(agent.device))
        utilities = agent.task.utility(world.state.to(agent.device), actions)
    captions = zip(
        _names(world.state, getattr(agent.task, "state_names", None), ""),
        _names(percepts, None, "x"),
        _names(actions, getattr(agent.task, "action_names", None), "a"),
        utilities.tolist(),
        strict=True,
    )
    texts = [f"{state}  {percept}  {act}  U {value:.3g}" for state, percept, act, value in captions]
    return _grid(grey_levels(agent.task.observation_space, world.observation), texts)


def _grid(frames: Tensor, captions: Sequence[str]) -> Image.Image:
    """Frames (count, channels, height, width) in rows, enlarged, with a caption below each."""
    levels = (frames * 255).round().byte().permute(0, 2, 3, 1).cpu().numpy()
    written = [legible(caption, LETTERS) for caption in captions]
    width = max(TILE_WIDTH, *(round(own.getlength(text)) for text, own in written))
    height = max(1, round(TILE_WIDTH * levels.shape[1] / levels.shape[2]))
    across, down = width + MARGIN, height + CAPTION_HEIGHT + MARGIN
    rows = -(-len(captions) // COLUMNS)
    grid = Image.new("RGB", (MARGIN + COLUMNS * across, MARGIN + rows * down), "white")
    draw = ImageDraw.Draw(grid)
    for number, (frame, (caption, own)) in enumerate(zip(levels, written, strict=True)):
        left, top = MARGIN + number % COLUMNS * across, MARGIN + number // COLUMNS * down
        picture = Image.fromarray(np.broadcast_to(frame, (*frame.shape[:2], 3)).copy())
        enlarged = picture.resize((TILE_WIDTH, height), Image.Resampling.NEAREST)
        grid.paste(enlarged, (left + (width - TILE_WIDTH) // 2, top))
        middle = left + width / 2, top + height + CAPTION_HEIGHT / 2
        draw.text(middle, caption, "black", own, anchor="mm")
    return grid


def _example_worlds(agent: Agent) -> World:
    generator = counted_generator(agent.seed, 0, "frames")
    if not isinstance(agent.task, FiniteStateTask):
        return agent.task.sample(PICTURES, generator)
    states = len(agent.task.prior)
    each = max(1, PICTURES // states) if not agent.task.noiseless else 1
    state = torch.arange(states).repeat_interleave(each)
    return World(state, agent.task.observe(state, generator))


def _names(values: Tensor, names: tuple[str, ...] | None, prefix: str) -> list[str]:
    if values.ndim > 1 or values.is_floating_point():
        rows = values.reshape(len(values), -1).tolist()
        return [" ".join(f"{number:.2g}" for number in row) for row in rows]
    return [names[value] if names else f"{prefix}{value}" for value in values.tolist()]
