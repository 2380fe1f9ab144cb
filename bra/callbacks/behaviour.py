"""The channels as pictures."""

import lightning.pytorch as pl
import numpy as np
from lightning.pytorch.loggers import TensorBoardLogger
from PIL import Image

from bra.agent import Agent
from bra.callbacks.schedule import Monitor
from bra.evaluation.evaluation import Evaluation
from bra.pictures import draw_heatmap
from bra.tasks import FiniteStateTask, FiniteTask

LARGEST_TABLE = 64
"""Rows or columns beyond which a heatmap is no longer readable, and not drawn."""


class BehaviourFigures(Monitor):
    """Draws the channels as heatmaps into TensorBoard, for discrete states, percepts and actions.

    Figures: `behaviour/p_action_given_state`, `behaviour/p_percept_given_state`,
    `behaviour/p_action_given_percept`. Tables of more than 64 rows or columns are not drawn.

    Args:
        every_n_updates: Updates between two drawings.
    """

    def __init__(self, every_n_updates: int = 10_000) -> None:
        super().__init__(every_n_updates)

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Draws all figures."""
        boards = [logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)]
        if not boards or not isinstance(agent.task, FiniteStateTask):
            return
        for name, picture in behaviour_figures(agent).items():
            for board in boards:
                board.experiment.add_image(
                    f"behaviour/{name}", np.asarray(picture), agent.updates, dataformats="HWC"
                )


def behaviour_figures(agent: Agent) -> dict[str, Image.Image]:
    """Heatmaps of p(a|ω), p(x|ω) and p(a|x), as far as they are discrete and readable.

    Percepts that hardly occur have rows of p(a|x) that say nothing, hence p(x) beside their names.

    Args:
        agent: One whose task has finitely many states.
    """
    evaluation: Evaluation = agent.evaluation()
    task = agent.task
    assert isinstance(task, FiniteStateTask)
    states = list(task.state_names)
    weights = task.prior.to(evaluation.percept_given_state.device) @ evaluation.percept_given_state
    percepts = [f"x{i}" for i in range(len(weights))]
    weighted = [f"{name} ({p:.2f})" for name, p in zip(percepts, weights.tolist(), strict=True)]
    count = evaluation.action_given_percept.shape[1]
    actions = list(task.action_names) if isinstance(task, FiniteTask) else [""] * count
    tables = {
        "p_action_given_state": (evaluation.action_given_state, states, actions, "p(a|ω)"),
        "p_percept_given_state": (evaluation.percept_given_state, states, percepts, "p(x|ω)"),
        "p_action_given_percept": (
            evaluation.action_given_percept,
            weighted,
            actions,
            "p(a|x), in brackets p(x),",
        ),
    }
    title = f"after {agent.updates:,} updates\nJ = {evaluation.objective.objective:.4f}"
    return {
        name: draw_heatmap(table.cpu().numpy(), rows, columns, f"{symbol} {title}")
        for name, (table, rows, columns, symbol) in tables.items()
        if max(table.shape) <= LARGEST_TABLE
    }
