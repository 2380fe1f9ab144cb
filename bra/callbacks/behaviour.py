"""The channels as pictures."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import lightning.pytorch as pl
from lightning.pytorch.loggers import TensorBoardLogger
from torch import Tensor

from bra.agent import Agent
from bra.callbacks.schedule import Monitor
from bra.evaluation.evaluation import Evaluation
from bra.tasks import FiniteStateTask, FiniteTask

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LETTER = 0.085
"""Inches that a letter of a name takes."""
LARGEST_TABLE = 64
"""Rows or columns beyond which a heatmap is no longer readable, and not drawn."""


class BehaviourFigures(Monitor):
    """Draws the channels as heatmaps into TensorBoard, for discrete states, percepts and actions.

    Figures: `behaviour/p_action_given_state`, `behaviour/p_percept_given_state`,
    `behaviour/p_action_given_percept`. Tables of more than 64 rows or columns are not drawn.

    Args:
        every_n_updates: Updates between two drawings, each of which takes about as long as some
            hundred updates.
    """

    def __init__(self, every_n_updates: int = 10_000) -> None:
        super().__init__(every_n_updates)

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Draws all figures."""
        boards = [logger for logger in trainer.loggers if isinstance(logger, TensorBoardLogger)]
        if not boards or not isinstance(agent.task, FiniteStateTask):
            return
        for name, figure in behaviour_figures(agent).items():
            for board in boards:
                board.experiment.add_figure(f"behaviour/{name}", figure, agent.updates)


def behaviour_figures(agent: Agent) -> dict[str, "Figure"]:
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
        name: heatmap(table, rows, columns, f"{symbol} {title}")
        for name, (table, rows, columns, symbol) in tables.items()
        if max(table.shape) <= LARGEST_TABLE
    }


def heatmap(table: Tensor, rows: Sequence[str], columns: Sequence[str], title: str) -> "Figure":
    """A figure with one heatmap, see `draw_heatmap`."""
    from matplotlib.figure import Figure

    # Inches. TensorBoard shows pictures some 320 pixels wide: small figures, large letters. The
    # margins are known, so that matplotlib need not spend half of its time on finding them.
    left = 0.15 + LETTER * max(map(len, rows))
    bottom = 0.15 + LETTER * (max(map(len, columns)) if upright(columns) else 1)
    width = left + 0.3 * len(columns) + 0.1
    height = bottom + 0.26 * len(rows) + 0.45
    figure = Figure(figsize=(width, height), dpi=120)
    axes = figure.add_axes(
        (left / width, bottom / height, 1 - (left + 0.1) / width, 1 - (bottom + 0.45) / height)
    )
    draw_heatmap(axes, table, rows, columns)
    figure.suptitle(title, fontsize=8)
    return figure


def upright(columns: Sequence[str]) -> bool:
    """Whether names of columns are too long to be written side by side."""
    return max(map(len, columns)) > 3


def draw_heatmap(axes: "Axes", table: Tensor, rows: Sequence[str], columns: Sequence[str]) -> None:
    """A table of probabilities with names at its edges and values in its cells.

    White is 0 and dark blue 1; values below 0.005 are not written.

    Args:
        axes: Where to draw.
        table: (rows, columns), values in [0, 1].
        rows: Names of the rows.
        columns: Names of the columns.
    """
    axes.imshow(table.cpu().numpy(), vmin=0, vmax=1, cmap="Blues", aspect="auto")
    axes.set_xticks(range(len(columns)), columns, rotation=90 if upright(columns) else 0)
    axes.set_yticks(range(len(rows)), rows)
    axes.tick_params(length=0, labelsize=8)
    for row, values in enumerate(table.tolist()):
        for column, value in enumerate(values):
            if value >= 0.005:
                colour = "white" if value > 0.6 else "black"
                text = f"{value:.2f}".removeprefix("0")
                axes.text(column, row, text, ha="center", va="center", color=colour, fontsize=7)
