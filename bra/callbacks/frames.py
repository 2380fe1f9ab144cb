"""What the agent sees, and what it makes of it."""

import lightning.pytorch as pl
import numpy as np
import torch
from gymnasium.spaces import Box
from lightning.pytorch.loggers import TensorBoardLogger
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor
from torch.nn.functional import pad

from bra.agent import Agent
from bra.callbacks.schedule import Monitor
from bra.randomness.generators import counted, counted_generator
from bra.tasks import FiniteStateTask, World
from bra.tasks.observations import grey_levels, has_grey_levels

PICTURES = 16
COLUMNS = 4
MARGIN = 4
"""Pixels between the pictures of the grid."""
TILE_WIDTH = 160
"""Pixels of one frame in the grid, across."""
CAPTION_HEIGHT = 24


class ObservationFrames(Monitor):
    """Shows image observations in a grid, with the agent's percept and action under each.

    For tasks whose observations are a bounded `Box` of shape (1 or 3, height, width), the same
    range for all pixels, which is shown from black to white; others have no pictures. Image:
    `observations/percept_and_action`, of some 16 signals that no update sees, the same at every
    look; each caption says state, percept, action and utility.

    Args:
        every_n_updates: Updates between two pictures.
    """

    def __init__(self, every_n_updates: int = 10_000) -> None:
        super().__init__(every_n_updates)

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Draws the grid."""
        boards = [logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)]
        if not boards or not shows_images(agent):
            return
        grid = frame_grid(agent)
        for board in boards:
            board.experiment.add_image("observations/percept_and_action", grid, agent.updates)


def shows_images(agent: Agent) -> bool:
    """Whether an agent's observations can be shown as pictures."""
    space = agent.task.observation_space
    return (
        isinstance(space, Box)
        and len(space.shape) == 3
        and space.shape[0] in (1, 3)
        and has_grey_levels(space)
    )


def frame_grid(agent: Agent) -> Tensor:
    """Signals of all states with what the agent does, (3, height, width), 0 to 1.

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
    tiles = [
        _tile(frame, f"{state}  {percept}  {action}  U {utility:.3g}")
        for frame, (state, percept, action, utility) in zip(
            grey_levels(agent.task.observation_space, world.observation), captions, strict=True
        )
    ]
    return _grid(torch.stack(tiles))


def _grid(tiles: Tensor) -> Tensor:
    """Pictures (count, 3, height, width) in rows, with white around each."""
    blanks = tiles.new_ones(-len(tiles) % COLUMNS, *tiles.shape[1:])
    framed = pad(torch.cat([tiles, blanks]), (0, MARGIN, 0, MARGIN), value=1.0)
    rows = framed.reshape(-1, COLUMNS, *framed.shape[1:])
    grid = rows.permute(2, 0, 3, 1, 4).flatten(3, 4).flatten(1, 2)
    return pad(grid, (MARGIN, 0, MARGIN, 0), value=1.0)


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


def _tile(frame: Tensor, caption: str) -> Tensor:
    """A frame enlarged, its pixels visible, with a caption below."""
    levels = (frame * 255).round().byte().permute(1, 2, 0).cpu().numpy()
    picture = Image.fromarray(np.broadcast_to(levels, (*levels.shape[:2], 3)).copy())
    height = max(1, round(TILE_WIDTH * picture.height / picture.width))
    tile = Image.new("RGB", (TILE_WIDTH, height + CAPTION_HEIGHT), "white")
    tile.paste(picture.resize((TILE_WIDTH, height), Image.Resampling.NEAREST))
    draw = ImageDraw.Draw(tile)
    font = ImageFont.load_default(size=15)
    draw.text((TILE_WIDTH / 2, height + CAPTION_HEIGHT / 2), caption, "black", font, anchor="mm")
    return torch.from_numpy(np.asarray(tile).copy()).permute(2, 0, 1) / 255
