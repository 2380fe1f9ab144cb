"""Figures of agents that learn, laid out as they were published."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from bra.checks.words import amount
from bra.objective import bits
from bra.reproductions.experiments import AGENTS, INFORMATIONS, Training

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS, BASELINE = ("#08519c", "#d95f02", "#1b9e77"), "tab:red"
"""Of the regimes, in their order; of the optimum where there is one regime."""


def draw_figures(training: Training) -> dict[str, "Figure"]:
    """What the paper draws of one regime in a figure, of several in two, by name."""
    if len(training.regimes) == 1:
        return {"learning": draw_learning(training)}
    return {"development": draw_development(training), "behaviour": draw_behaviour(training)}


def draw_learning(training: Training) -> "Figure":
    """A: utilities; B: J, all agents, the best one in black; C: p(a|ω) of the best one."""
    figure = _figure(14.0, 4.2)
    axes = figure.subplots(1, 3)
    (regime,), task = training.regimes, training.task
    _draw_utilities(axes[0], training)
    _draw_curves(axes[1], training, "objective", ("black",), BASELINE)
    axes[1].set_ylabel("J, dashed: optimum")
    axes[1].set_title(f"B  {training.rule}", loc="left")
    agent = training.population.member(training.best(regime))
    draw_heatmap(axes[2], agent.behaviour(), task.state_names, task.action_names)
    axes[2].set_title(f"C  p(a|ω) after {amount(agent.updates, 'update')}", loc="left")
    return figure


def draw_development(training: Training) -> "Figure":
    """A: utilities; B: J and, dashed, its optimum; C and D: I(Ω;X) and I(X;A), of all regimes."""
    figure = _figure(9.6, 7.0)
    (utilities, objective), rates = figure.subplots(2, 2)
    _draw_utilities(utilities, training)
    _draw_curves(objective, training, "objective", COLOURS)
    objective.set_ylabel("J, dashed: optimum")
    for axes, (term, symbol) in zip(rates, INFORMATIONS.items(), strict=True):
        _draw_curves(axes, training, term, COLOURS)
        axes.set_ylabel(f"{symbol} in bits, dashed: optimum")
    for axes, letter in zip((objective, *rates), "BCD", strict=True):
        axes.set_title(f"{letter}  {training.rule}", loc="left")
    return figure


def draw_behaviour(training: Training) -> "Figure":
    """p(a|ω) and p(x|ω) of the best agent of each regime, a row each."""
    figure = _figure(7.4, 2.4 * len(training.regimes))
    rows = figure.subplots(len(training.regimes), 2)
    letters, task = iter("ABCDEF"), training.task
    for (left, right), regime in zip(rows, training.regimes, strict=True):
        found = training.population.member(training.best(regime)).evaluation()
        percepts = [f"x{number}" for number in range(found.percept_given_state.shape[1])]
        for axes, table, columns, symbol in (
            (left, found.action_given_state, task.action_names, "p(a|ω)"),
            (right, found.percept_given_state, percepts, "p(x|ω)"),
        ):
            draw_heatmap(axes, table, task.state_names, columns)
            axes.set_title(f"{next(letters)}  {symbol} at {regime.name}", loc="left")
    return figure


def draw_heatmap(axes: "Axes", table: Tensor, rows: Sequence[str], columns: Sequence[str]) -> None:
    """A table, white is 0 and dark blue 1, or what is above it; below 0.005 nothing is written."""
    shares = table.max() < 1 + 1e-6
    top = 1.0 if shares else table.max().item()
    axes.imshow(table.numpy(), vmin=0, vmax=top, cmap="Blues", aspect="auto")
    axes.set_xticks(range(len(columns)), columns, rotation=90 if max(map(len, columns)) > 3 else 0)
    axes.set_yticks(range(len(rows)), rows)
    axes.tick_params(length=0, labelsize=8)
    for row, values in enumerate(table.tolist()):
        for column, value in enumerate(values):
            if value >= 0.005:
                colour = "white" if value > 0.6 * top else "black"
                text = f"{value:.2f}".removeprefix("0") if shares else f"{value:g}"
                axes.text(column, row, text, ha="center", va="center", color=colour, fontsize=7)


def _draw_utilities(axes: "Axes", training: Training) -> None:
    task = training.task
    draw_heatmap(axes, task.utilities, task.state_names, task.action_names)
    axes.set_title("A  U(ω, a)", loc="left")


def _draw_curves(
    axes: "Axes", training: Training, term: str, colours: Sequence[str], dashed: str = ""
) -> None:
    """A term of J of all agents over updates: each regime's in one colour, its best agent bold."""
    updates, unit = training.course.updates, 1.0 if term == "objective" else bits(1.0)
    values = torch.stack([getattr(terms, term) for terms in training.course.terms]) * unit
    for place, (regime, colour) in enumerate(zip(training.regimes, colours, strict=False)):
        own = values[:, place * AGENTS : (place + 1) * AGENTS]
        axes.plot(updates, own, color=colour, alpha=0.25, lw=0.7)
        label = f"best of {AGENTS}, {regime.name}"
        axes.plot(updates, values[:, training.best(regime)], color=colour, lw=1.6, label=label)
        optimum = float(getattr(training.references[regime.prices].optimum, term)) * unit
        axes.axhline(optimum, ls="--", lw=1.3, color=dashed or colour)
    axes.set_xlabel("updates")
    axes.set_xlim(0, updates[-1])
    axes.locator_params(axis="x", nbins=5)
    axes.grid(alpha=0.3)
    if term == "objective":
        axes.legend(fontsize=8, loc="center right")


def _figure(width: float, height: float) -> "Figure":
    from matplotlib.figure import Figure  # takes half a second, and serves pictures only

    return Figure(figsize=(width, height), layout="constrained")
