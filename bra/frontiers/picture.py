"""Frontiers as figures for a paper, by matplotlib."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from torch import Tensor

from bra.frontiers.frontier import Frontier
from bra.objective import bits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CHANNELS = {
    "perception_information": "I(Ω;X)",
    "action_information": "I(X;A)",
    "direct_information": "I(Ω;A|X)",
    "end_to_end_information": "I(Ω;A)",
}
OPTIMUM, BOUND, CHANGE, AGENT = "#08519c", "#7f7f7f", "#d95f02", "#1b9e77"


def draw_frontier(found: Frontier, agents: Mapping[str, Tensor] | None = None) -> "Figure":
    """E[U] against each information, in bits: optimum, certified bound, changes, agents.

    Args:
        found: A curve, or a grid, which is drawn as maps of the same quantities over the prices.
        agents: E[U] and informations of trained agents, (R,) each, by their names.
    """
    from matplotlib.figure import Figure  # takes half a second, and serves pictures only

    known = {n: symbol for n, symbol in CHANNELS.items() if getattr(found, n) is not None}
    figure = Figure(figsize=(3.2 * len(known), 3.4), layout="constrained")
    if (found.beta_perception.diff() == 0).any():
        _draw_maps(figure, found)
        return figure
    for axes, (name, symbol) in zip(
        figure.subplots(1, len(known), sharey=True), known.items(), strict=True
    ):
        _draw_curve(axes, found, name)
        if agents is not None:
            information = agents[name] * bits(1.0)
            axes.plot(information, agents["expected_utility"], "x", color=AGENT, label="agents")
        axes.set_xlabel(f"{symbol} in bits")
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("E[U]")
    figure.axes[0].ticklabel_format(axis="y", useOffset=False)
    figure.axes[0].legend(loc="lower right", frameon=False)
    return figure


def _draw_curve(axes: "Axes", found: Frontier, name: str) -> None:
    """The optimum, broken where it jumps: no price has the rates between."""
    information = getattr(found, name) * bits(1.0)
    axes.plot(information, found.utility_bound, ":", color=BOUND, label="certified bound")
    after = [index for index, text in enumerate(found.change) if text]
    edges = zip([0, *after], [*after, len(information)], strict=True)
    label = "optimum"
    for start, end in edges:
        piece = slice(start, end)
        axes.plot(information[piece], found.expected_utility[piece], color=OPTIMUM, label=label)
        label = ""
    for index in after:
        jump = slice(index - 1, index + 1)
        axes.plot(information[jump], found.expected_utility[jump], "--", color=OPTIMUM, lw=0.8)
    axes.plot(
        information[after],
        found.expected_utility[after],
        "o",
        color=CHANGE,
        markerfacecolor="white",
        label="percepts come or go",
    )


def _draw_maps(figure: "Figure", found: Frontier) -> None:
    """E[U] and two informations over both prices."""
    down = found.beta_action[: int((found.beta_perception == found.beta_perception[0]).sum())]
    across = found.beta_perception[:: len(down)]
    shown: dict[str, Any] = {
        "E[U]": found.expected_utility,
        "I(Ω;X) in bits": found.perception_information * bits(1.0),
        "I(X;A) in bits": found.action_information * bits(1.0),
    }
    rooms = figure.subplots(1, 3, sharey=True)
    for axes, (title, values) in zip(rooms, shown.items(), strict=True):
        table = values.reshape(len(across), len(down)).T
        colours = axes.pcolormesh(across, down, table, cmap="Blues", shading="nearest")
        figure.colorbar(colours, ax=axes)
        axes.set(title=title, xscale="log", yscale="log", xlabel="β₁ per nat")
    figure.axes[0].set_ylabel("β₂ per nat")
