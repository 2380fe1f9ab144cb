"""`bra reproduce`: values of the literature beside what comes out here."""

from collections.abc import Sequence

from bra.agent.run_folder import run_folder
from bra.cli.errors import suggest
from bra.reproductions import EXPERIMENTS, PROBLEMS, Experiment, Value
from bra.reproductions.experiments import AGENTS, RULES, train
from bra.reproductions.figures import draw_figures

KNOWN = PROBLEMS | EXPERIMENTS


def reproduce(name: str = "", folder: str = ".") -> None:
    """Works a published problem out again and prints both numbers; without a name, lists them.

    What was trained is trained again, by the published rule and by the one that agents choose; the
    paper's figures are drawn into a new folder of each run, as PNG and PDF, beside `curves.csv` and
    `population.csv`.

    Args:
        name: Of the problem.
        folder: Where the folders of runs go.

    Raises:
        ImportError: If the problem needs a simulator that is not installed.
        ValueError: If there is no such problem.
    """
    if not name:
        for known, problem in KNOWN.items():
            print(f"{known:23}{problem.title}")
        return
    if name not in KNOWN:
        raise ValueError(f"unknown problem {name}; {suggest(name, KNOWN)}")
    print(f"{KNOWN[name].title}\nsource: {KNOWN[name].source}\n", flush=True)
    if name in EXPERIMENTS:
        reproduce_training(EXPERIMENTS[name], folder)
    else:
        print(comparison(PROBLEMS[name].solve()))


def reproduce_training(experiment: Experiment, folder: str) -> None:
    """Trains by both rules, draws the figures, and prints the table."""
    agents = AGENTS * len(experiment.regimes)
    lengths = ", then ".join(f"{count:,} updates by the {rule}" for rule, count in RULES.items())
    print(f"trains {agents} agents at once: {lengths}; one to three minutes in all", flush=True)
    values, written = [], []
    for rule in RULES:
        training, trainer = train(experiment, rule, folder)
        values += training.values()
        for name, figure in draw_figures(training).items():
            for kind in ("png", "pdf"):
                figure.savefig(run_folder(trainer).file(f"{name}.{kind}"), dpi=200)
            written.append(f"{rule}: {run_folder(trainer).path / name}.png and .pdf")
    print(f"\n{comparison(values)}\n")
    print("\n".join(written))


def comparison(values: Sequence[Value]) -> str:
    """Numbers as a table."""
    lines = [f"{'':50}{'reference':>12}{'here':>12}{'bound':>12}"]
    for value in values:
        cells = map(_cell, (value.reference, value.found, value.bound))
        lines.append(f"{value.quantity:50}{''.join(cells)}")
    return "\n".join(lines)


def _cell(number: float | None) -> str:
    return f"{'–' if number is None else f'{round(number, 7):.6g}':>12}"
