"""The channels as pictures."""

from dataclasses import dataclass

import lightning.pytorch as pl
import torch
from PIL.Image import Image
from torch import Tensor

from bra.agent import Agent
from bra.blahut_arimoto import Serial
from bra.callbacks.baseline import baseline_of
from bra.callbacks.pictures import log_pictures
from bra.callbacks.schedule import Monitor
from bra.checks.words import amount
from bra.evaluation import Evaluation
from bra.pictures import beside, draw_heatmap
from bra.tasks import FiniteStateTask, FiniteTask

LARGEST_TABLE = 64
"""Rows or columns beyond which a heatmap is no longer readable, and not drawn."""
UNUSED = 0.005
"""p(x|ω) of every state below which a percept is grey."""


class BehaviourFigures(Monitor):
    """Draws the channels as heatmaps, the optimum's beside the agent's, where they are discrete.

    Pictures, for every logger that takes some: `behaviour/p_action_given_state`,
    `behaviour/p_percept_given_state`, `behaviour/p_action_given_percept`, and, where actions look
    at the state again, `behaviour/p_action_given_percept_and_state`, in which p(x|ω) stands beside
    the names. The optimum is that of the run's `BaselineMonitor`, its percepts in the order that
    fits the agent's. Percepts that hardly occur are grey. Tables of more than 64 rows or columns
    are not drawn.

    Args:
        every_n_updates: Updates between two drawings; None is some eighth of the run.
    """

    def __init__(self, every_n_updates: int | None = None) -> None:
        super().__init__(every_n_updates)

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Draws all figures."""
        if isinstance(agent.task, FiniteStateTask):
            baseline = baseline_of(trainer)
            optimum = baseline.reference(agent).optimum if baseline else None
            log_pictures(
                trainer, "behaviour", agent.updates, lambda: behaviour_figures(agent, optimum)
            )


@dataclass(frozen=True)
class Tables:
    """p(x|ω), (W, X), and p(a|x), (X, A), with p(x), (X,), and p(a|ω), (W, A).

    And p(a|x,ω), (X, W, A), where actions look at the state again, else None.
    """

    percept_given_state: Tensor
    action_given_percept: Tensor
    percept: Tensor
    action_given_state: Tensor
    looks: Tensor | None = None

    @classmethod
    def of(cls, known: Evaluation | Serial, prior: Tensor) -> "Tables":
        """Those of an agent or an optimum."""
        percepts = known.percept_given_state.cpu()
        actions = known.action_given_percept.cpu()
        looks = getattr(known, "action_given_percept_and_state", None)
        looks = None if looks is None else looks.cpu()
        return cls(percepts, actions, prior @ percepts, known.action_given_state.cpu(), looks)

    def like(self, other: "Tables", prior: Tensor) -> "Tables":
        """The same channels, their percepts in the order that fits others best.

        One pair of percepts after the other, that of the largest Σ_ω p(ω) p(x|ω) p'(x'|ω).
        """
        overlap = (prior * other.percept_given_state.T) @ self.percept_given_state
        order = torch.zeros(len(overlap), dtype=torch.long)
        for _ in range(len(overlap)):
            place, percept = divmod(int(overlap.argmax()), len(overlap))
            order[place] = percept
            overlap[place], overlap[:, percept] = -1, -1
        percepts, actions = self.percept_given_state[:, order], self.action_given_percept[order]
        looks = None if self.looks is None else self.looks[order]
        return Tables(percepts, actions, self.percept[order], self.action_given_state, looks)


def behaviour_figures(agent: Agent, optimum: Serial | None = None) -> dict[str, Image]:
    """Heatmaps of p(a|ω), p(x|ω) and p(a|x), by name, as far as they are discrete and readable.

    Args:
        agent: One whose task has finitely many states.
        optimum: What is drawn beside it, if its channels are between as many.
    """
    assert isinstance(agent.task, FiniteStateTask)
    evaluation, prior = agent.evaluation(), agent.task.prior
    own = Tables.of(evaluation, prior)
    title = f"after {amount(agent.updates, 'update')}\nJ = {evaluation.objective.objective:.4f}"
    figures = _heatmaps(agent.task, own, title)
    if optimum is None or optimum.percept_given_state.shape != own.percept_given_state.shape:
        return figures
    best = Tables.of(optimum, prior).like(own, prior)
    title = f"of the optimum\nJ = {float(optimum.objective):.4f}"
    optima = _heatmaps(agent.task, best, title)
    return {name: beside(figure, optima[name]) for name, figure in figures.items()}


def _heatmaps(task: FiniteStateTask, tables: Tables, title: str) -> dict[str, Image]:
    """Percepts that hardly occur say nothing: they are grey, and p(x) stands beside their names.

    So are, where actions look again, pairs of a state and a percept that it hardly leads to.
    """
    states, count = list(task.state_names), tables.action_given_percept.shape[1]
    actions = list(task.action_names) if isinstance(task, FiniteTask) else [""] * count
    percepts = [f"x{i}" for i in range(len(tables.percept))]
    shares = zip(percepts, tables.percept.tolist(), strict=True)
    weighted = [f"{name} ({share:.2f})" for name, share in shares]
    unused = tables.percept_given_state[task.prior > 0].amax(0) < UNUSED
    drawn = {
        "p_action_given_state": (tables.action_given_state, states, actions, "p(a|ω)", None),
        "p_percept_given_state": (tables.percept_given_state, states, percepts, "p(x|ω)", unused),
        "p_action_given_percept": (
            *(tables.action_given_percept, weighted, actions, "p(a|x) and (p(x))"),
            unused.unsqueeze(1),
        ),
    }
    if tables.looks is not None:
        sent = tables.percept_given_state.T.flatten()
        pairs = [f"{percept} {state}" for percept in percepts for state in states]
        drawn["p_action_given_percept_and_state"] = (
            tables.looks.flatten(0, 1),
            [f"{pair} ({share:.2f})" for pair, share in zip(pairs, sent.tolist(), strict=True)],
            *(actions, "p(a|x,ω) and (p(x|ω))", (sent < UNUSED).unsqueeze(1)),
        )
    return {
        name: draw_heatmap(
            *(table.numpy(), rows, columns, f"{symbol} {title}"),
            void=None if void is None else void.expand_as(table).numpy(),
        )
        for name, (table, rows, columns, symbol, void) in drawn.items()
        if max(table.shape) <= LARGEST_TABLE
    }
