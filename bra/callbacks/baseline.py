"""The certified optimum beside the curves."""

import lightning.pytorch as pl
from lightning.pytorch.loggers import TensorBoardLogger

from bra.agent import Agent, Learner
from bra.callbacks.custom_scalars import lay_over
from bra.callbacks.information import FLOW
from bra.callbacks.schedule import CurveMonitor, agent_of, learner_of, log_metrics
from bra.checks.settings import check_count, check_seconds
from bra.evaluation.references import Prices, Reference, solve_references
from bra.objective import TERMS, Term
from bra.tasks import knows_signals

OBJECTIVES = (
    "objective/J",
    "objective/blahut_arimoto",
    "objective/upper_bound",
    "objective/without_sensor_noise",
)
"""In the order in which TensorBoard gives them markers: square, diamond, triangle, star."""


class BaselineMonitor(CurveMonitor):
    """Solves for the optimum when training starts, and logs it as lines over the whole run.

    Logged keys: `objective/blahut_arimoto`, J of the best serial Blahut-Arimoto solution that the
    sensor allows; `objective/without_sensor_noise`, what it would be if a noisy sensor had no
    noise; `objective/upper_bound`, which no agent can exceed; and `objective/gap`, by which the
    agent falls short of the optimum, and which the progress bar shows; `optimum/expected_utility`,
    `optimum/perception_bits`, `optimum/…`, what the optimum earns and spends, as far as the
    agent's own is known. In TensorBoard a custom-scalars page lays J, optimum and bound over each
    other, and each term of J over the optimum's; squares are the agent, diamonds the optimum.

    Percepts that are not discrete, and sensors of unknown noise, have a bound and no optimum; tasks
    without a table of utilities have an optimum on grids, and no bound, if they say how to put them
    on one, see `bra.Task.grid`, else neither. The prices of a population's agents are solved for
    together; the lines are those of the prices of its best agent.

    Args:
        restarts: Starts of the serial problem, which has local optima.
        every_n_updates: Updates between two points of the lines; None is 100 (of more
            than 256 agents 200, …), and a hundredth of runs of more than 10 000 updates.
        certify: Seconds to spend on lowering the bound of a single pair of prices when training
            starts, as in `bra.blahut_arimoto.serial`.

    Attributes:
        references: Optimum and bound for each pair of prices, once training has started.
    """

    def __init__(
        self, restarts: int = 32, every_n_updates: int | None = None, certify: float | None = None
    ) -> None:
        super().__init__(every_n_updates)
        self.certify = None if certify is None else check_seconds(certify, "certify")
        self.restarts = check_count(restarts, "restarts")
        self.references: dict[Prices, Reference] = {}

    def on_fit_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Solves."""
        learner = learner_of(pl_module)
        self.references = solve_all_references(learner, self.restarts, self.certify)

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """The first look, and the page that lays curves over each other."""
        super().on_train_start(trainer, pl_module)
        agent = agent_of(pl_module)
        charts = _charts(agent, self.reference(agent))
        for logger in trainer.loggers:
            if isinstance(logger, TensorBoardLogger) and trainer.is_global_zero:
                lay_over(logger, charts)

    def on_test_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Solves, for the table that a test ends with."""
        learner = learner_of(pl_module)
        self.references = solve_all_references(learner, self.restarts, self.certify)

    def reference(self, agent: Agent) -> Reference:
        """What there is to compare an agent with, at its own prices; solves for new ones."""
        self._solve_for(agent)
        return self.references[agent.beta_perception, agent.beta_action]

    def _solve_for(self, learner: Learner) -> None:
        """Adds the optima at prices of agents that are new."""
        if {setting.prices for setting in learner.settings} - self.references.keys():
            self.references |= solve_all_references(learner, self.restarts, self.certify)

    def on_train_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """The last look, for which prices that follow budgets have come to rest."""
        self._solve_for(learner_of(pl_module))
        super().on_train_end(trainer, pl_module)

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Draws the lines on, and the gap in the bar; none at prices that are on their way."""
        if (agent.beta_perception, agent.beta_action) not in self.references:
            return
        reference = self.reference(agent)
        values = (reference.objective, reference.bound, reference.objective_without_noise)
        lines = {n: v for n, v in zip(OBJECTIVES[1:], values, strict=True) if v is not None}
        lines |= {_tag(term): value for term, value in _terms(agent, reference).items()}
        if reference.objective is not None:
            gap = reference.objective - agent.evaluate().objective
            lines["objective/gap"] = trainer.progress_bar_metrics["gap"] = gap
        log_metrics(trainer, lines)


def _terms(agent: Agent, reference: Reference) -> dict[Term, float]:
    """Those of the optimum's J that are known of the agent, too; information in bits."""
    known = {name: getattr(reference.optimum, name, None) for name in agent.evaluate().known()}
    return {
        term: term.shown(float(value))
        for name, term in TERMS.items()
        if name != "objective" and (value := known.get(name)) is not None
    }


def _tag(term: Term) -> str:
    """The name of a term of the optimum's J."""
    return f"optimum/{term.tag.rpartition('/')[2]}"


def _charts(agent: Agent, reference: Reference) -> dict[str, list[str]]:
    """Tags of the curves to be laid over each other, by title."""
    charts = {"J, its optimum and its bound": [*OBJECTIVES]}
    for term in _terms(agent, reference):
        # A noiseless sensor says all of the state, so that I(ξ;X) is I(Ω;X).
        symbol = term.symbol.replace("ξ", "Ω") if knows_signals(agent.task) else term.symbol
        title = f"{symbol}{' in bits' if term.in_bits else ''}, of agent and optimum"
        charts[title] = [term.tag, _tag(term)]
    names = agent.evaluate().known()
    charts["information in bits"] = [t.tag for n, t in TERMS.items() if n in names and t.in_bits]
    if agent.beta_direct is not None:
        charts["I(Ω;X), on it I(X;A), on both I(Ω;A|X), in bits"] = [*FLOW]
    return charts


def baseline_of(trainer: pl.Trainer) -> BaselineMonitor | None:
    """The run's monitor of the optimum, if it has one."""
    callbacks: list[pl.Callback] = trainer.callbacks  # type: ignore[attr-defined]  # set by a connector
    return next((c for c in callbacks if isinstance(c, BaselineMonitor)), None)


def solve_reference(agent: Agent, restarts: int = 32, certify: float | None = None) -> Reference:
    """What there is to compare an agent with."""
    (found,) = solve_all_references(agent, restarts, certify).values()
    return found


def solve_all_references(
    learner: Learner, restarts: int = 32, certify: float | None = None
) -> dict[Prices, Reference]:
    """What there is to compare agents with at each of their prices."""
    agent = learner.best_agent()
    prices = list(dict.fromkeys(setting.prices for setting in learner.settings))
    task, percepts = agent.task, agent.percept_space
    return solve_references(
        task, percepts, prices, learner.seed, restarts, certify, agent.beta_direct
    )
