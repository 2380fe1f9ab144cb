"""Draws the pictures of the documentation from a finished run.

bra fit --config configs/predator_prey.yaml
python docs/pictures.py lightning_logs/version_0 docs/predator_prey.png
bra fit --config configs/medical.yaml
python docs/pictures.py lightning_logs/version_1 docs/specialists.png
"""

import sys
from pathlib import Path

import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from bra import Agent
from bra.callbacks.baseline import solve_reference
from bra.reproductions.figures import draw_heatmap

INFORMATION = {"perception": "I(Ω;X) perception", "action": "I(X;A) action"}


def draw_run(folder: Path) -> Figure:
    """Curves of a run on the left, what the agent does beside the optimum on the right."""
    agent = Agent.load_from_checkpoint(folder / "checkpoints" / "last.ckpt")
    optimum = solve_reference(agent).optimum
    events = EventAccumulator(str(folder))
    events.Reload()

    figure = Figure(figsize=(12.5, 4.4), dpi=110, layout="constrained")
    layout = figure.subplot_mosaic([["J", "agent", "optimum"], ["bits", "agent", "optimum"]])
    draw_objective(layout["J"], events)
    draw_information(layout["bits"], events)
    names = (agent.task.state_names, agent.task.action_names)
    draw_heatmap(layout["agent"], agent.behaviour(), *names)
    layout["agent"].set_title(f"p(a|ω) of the agent, J = {agent.evaluate().objective:.3f}")
    draw_heatmap(layout["optimum"], optimum.action_given_state, *names)
    layout["optimum"].set_title(f"p(a|ω) of the optimum, J = {optimum.objective:.3f}")
    return figure


def draw_specialists(folder: Path) -> Figure:
    """What flows where, and the channels of an agent whose actions look at the state again."""
    agent = Agent.load_from_checkpoint(folder / "checkpoints" / "last.ckpt")
    found, events = agent.evaluation(), EventAccumulator(str(folder))
    events.Reload()
    states, actions = agent.task.state_names, agent.task.action_names
    percepts = [f"x{i}" for i in range(len(found.action_given_percept))]
    figure = Figure(figsize=(12.5, 5.6), dpi=110, layout="constrained")
    plan = [["flow", "selector", "looks"], ["flow", "models", "looks"]]
    layout = figure.subplot_mosaic(plan, height_ratios=[2, 1], width_ratios=[1, 1, 1.3])
    draw_flow(layout["flow"], events)
    draw_heatmap(layout["selector"], found.percept_given_state, states, percepts)
    layout["selector"].set_title("p(x|ω), who sees whom")
    draw_heatmap(layout["models"], found.action_given_percept, percepts, actions)
    layout["models"].set_title("p(a|x), what specialists begin with")
    seen = [
        (found.action_given_percept_and_state[x, w], f"{percept} {state}")
        for x, percept in enumerate(percepts)
        for w, state in enumerate(states)
        if found.percept_given_state[w, x] >= 0.005
    ]
    rows, names = zip(*seen, strict=True)
    draw_heatmap(layout["looks"], torch.stack(rows), names, actions)
    layout["looks"].set_title("p(a|x,ω), what they do for those they see")
    return figure


def draw_flow(axes: Axes, events: EventAccumulator) -> None:
    """The three informations over updates, one on top of the other."""
    labels = {"perception": "I(Ω;X)", "action": "I(X;A)", "direct": "I(Ω;A|X)"}
    points = [events.Scalars(f"information/{name}_bits") for name in labels]
    steps = [point.step for point in points[0]]
    axes.stackplot(
        steps,
        *([point.value for point in line] for line in points),
        labels=[*labels.values()],
        colors=["#08519c", "#6baed6", "#fdae6b"],
    )
    axes.set(title="information flow", xlabel="updates", ylabel="bits", xlim=(0, steps[-1]))
    axes.legend(fontsize=8, loc="lower right")


def draw_objective(axes: Axes, events: EventAccumulator) -> None:
    """J, its optimum and its bound over updates."""
    lines = {
        "objective/upper_bound": ("certified bound", "0.6", "--"),
        "objective/blahut_arimoto": ("Blahut-Arimoto optimum", "tab:red", "--"),
        "objective/J": ("J of the agent", "tab:blue", "-"),
    }
    for tag, (label, colour, style) in lines.items():
        points = events.Scalars(tag)
        steps, values = [p.step for p in points], [p.value for p in points]
        axes.plot(steps, values, style, color=colour, label=label)
    axes.set_ylabel("J (utility)")
    axes.legend(fontsize=8, loc="lower right")
    axes.grid(alpha=0.3)


def draw_information(axes: Axes, events: EventAccumulator) -> None:
    """What both channels spend over updates."""
    for name, label in INFORMATION.items():
        points = events.Scalars(f"information/{name}_bits")
        axes.plot([p.step for p in points], [p.value for p in points], label=label)
    axes.set_xlabel("updates")
    axes.set_ylabel("information (bits)")
    axes.legend(fontsize=8, loc="lower right")
    axes.grid(alpha=0.3)


if __name__ == "__main__":
    draw = draw_specialists if "specialists" in sys.argv[2] else draw_run
    draw(Path(sys.argv[1])).savefig(sys.argv[2])
