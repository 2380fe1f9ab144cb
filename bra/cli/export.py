"""`bra export`: an agent and its optimum as tidy tables."""

import csv
import itertools
from collections.abc import Iterable, Sequence
from pathlib import Path

from gymnasium.spaces import Discrete
from torch import Tensor

from bra.blahut_arimoto import Serial
from bra.callbacks.baseline import solve_reference
from bra.cli.functions import load_agent, run_folder
from bra.evaluation import Evaluation
from bra.tasks import FiniteStateTask, FiniteTask, knows_signals

TABLES = {
    "percept_given_state": ("state", "percept"),
    "action_given_percept": ("percept", "action"),
    "action_given_percept_and_state": ("percept", "state", "action"),
    "action_given_state": ("state", "action"),
    "percept_marginal": ("percept",),
    "action_marginal": ("action",),
}
"""What the dimensions of each table are."""


def export(ckpt_path: str, folder: str | None = None, trusted: Sequence[str] | str = ()) -> None:
    """Writes p(x|ω), p(a|x), p(a|ω), p(x) and p(a) of a trained agent and its optimum, as CSV.

    And p(a|x,ω), where actions look at the state again.
    A row is one probability: `source` says whether it is the agent's or the optimum's, then stand
    what is given and what comes of it. Of a population it is the best agent. The percepts of agent
    and optimum have no common order.

    Args:
        ckpt_path: Checkpoint of an agent with finitely many states, percepts and actions.
        folder: Where the files go; None is a new folder of the run that the checkpoint is from:
            `export`, `export_1`, ….
        trusted: Module of one's own, or a list of them, that may be imported for the checkpoint's
            classes.

    Raises:
        ValueError: If the file is no checkpoint of such an agent, or tables are there already.
    """
    agent = load_agent(ckpt_path, trusted)
    task, spaces = agent.task, (agent.percept_space, agent.task.action_space)
    if not (isinstance(task, FiniteStateTask) and all(isinstance(s, Discrete) for s in spaces)):
        raise ValueError(
            "export writes tables of finitely many states, percepts and actions, got an agent of "
            f"{type(task).__name__}, {spaces[0]} and {spaces[1]}; use bra predict"
        )
    sources: dict[str, Evaluation | Serial | None] = {"agent": agent.evaluation()}
    if knows_signals(task):
        sources["optimum"] = solve_reference(agent).optimum
    tables = {
        source: tabulated(task.prior, found)
        for source, found in sources.items()
        if found is not None
    }
    names = names_of(task, *tables["agent"]["action_given_percept"].shape)
    written = {name: TABLES[name] for name in TABLES if name in tables["agent"]}
    target = _folder(folder, Path(ckpt_path), written)
    for name, dimensions in written.items():
        with (target / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["source", *dimensions, "probability"])
            for source, found in tables.items():
                labels = itertools.product(
                    [source], *(names[dimension] for dimension in dimensions)
                )
                probabilities = found[name].flatten().tolist()
                writer.writerows(
                    [*label, p] for label, p in zip(labels, probabilities, strict=True)
                )
    print(f"written to {target}: {', '.join(f'{name}.csv' for name in written)}")


def _folder(given: str | None, checkpoint: Path, names: Iterable[str]) -> Path:
    """Where tables go, so that they take the place of no others.

    Raises:
        ValueError: If some are in the folder that is given.
    """
    if given is None:
        beside = run_folder(checkpoint)
        numbered = (beside / f"export_{number}" for number in itertools.count(1))
        named = itertools.chain([beside / "export"], numbered)
        folder = next(path for path in named if not path.exists())
    else:
        folder = Path(given)
        if there := [path for name in names if (path := folder / f"{name}.csv").exists()]:
            raise ValueError(f"{there[0]} is there already; give another folder")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def tabulated(prior: Tensor, found: Evaluation | Serial) -> dict[str, Tensor]:
    """All tables that p(ω), (W,), and the channels of an agent or an optimum imply."""
    looks = getattr(found, "action_given_percept_and_state", None)
    return {
        "percept_given_state": found.percept_given_state,
        "action_given_percept": found.action_given_percept,
        "action_given_state": found.action_given_state,
        "percept_marginal": prior @ found.percept_given_state,
        "action_marginal": prior @ found.action_given_state,
    } | ({} if looks is None else {"action_given_percept_and_state": looks})


def names_of(task: FiniteStateTask, percepts: int, actions: int) -> dict[str, Sequence[str]]:
    """What states, percepts and actions are called."""
    called = task.action_names if isinstance(task, FiniteTask) else [str(i) for i in range(actions)]
    return {
        "state": task.state_names,
        "percept": [f"x{number}" for number in range(percepts)],
        "action": called,
    }
