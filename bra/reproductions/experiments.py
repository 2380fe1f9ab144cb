"""What was published of agents that learn, and the training that it takes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import lightning.pytorch as pl
from torch import Tensor
from torch.optim import SGD

from bra.agent import Agent
from bra.callbacks import BaselineMonitor, PopulationMonitor, UpdateBar
from bra.callbacks.hits import fares
from bra.callbacks.schedule import CurveMonitor, learner_of
from bra.channels import MLP, Multinomial
from bra.evaluation.references import Prices, Reference
from bra.marginals import ExactMarginals
from bra.objective import Objective, bits
from bra.population import Population
from bra.reproductions.problems import Value
from bra.tasks import FiniteTask, PredatorPrey, RolloutDataModule
from bra.tasks.nao_mugs import NaoMugs
from bra.update_rules import ScoreFunction

AGENTS, LOOKS = 8, 100
"""Seeds at each pair of prices; points of a curve."""
PAPER = "paper's rule"
RULES = {PAPER: 100_000, "projection": 2_000}
"""Updates of the published rule, and of the rule that agents choose by themselves."""
INFORMATIONS = {"perception_information": "I(Ω;X)", "action_information": "I(X;A)"}


@dataclass(frozen=True)
class Regime:
    """Prices, per nat, and the paper's learning rates at them."""

    beta_perception: float
    beta_action: float
    perception_rate: float
    action_rate: float

    @property
    def prices(self) -> Prices:
        """β₁ and β₂."""
        return self.beta_perception, self.beta_action

    @property
    def name(self) -> str:
        """The prices, for people."""
        return f"β₁ {self.beta_perception:g}, β₂ {self.beta_action:g}"


@dataclass(frozen=True)
class Experiment:
    """A published training, without and with what makes it reach the optimum.

    Attributes:
        title: What it is about, in a line.
        source: Where the figures stand.
        task: Makes it.
        percepts: |X|.
        hidden: Width of the paper's network, tanh without bias.
        regimes: Prices and rates.
    """

    title: str
    source: str
    task: Callable[[], FiniteTask]
    percepts: int
    hidden: int
    regimes: tuple[Regime, ...]

    def population(self, rule: str, task: FiniteTask) -> Population:
        """Agents of all regimes: as the paper has them, or with all that is left open chosen."""
        named = {name: [getattr(r, name) for r in self.regimes] for name in vars(self.regimes[0])}
        paper = {
            "perception": partial(MLP, hidden=[self.hidden], bias=False),
            "action": Multinomial,
            "update_rule": ScoreFunction(),
            "perception_optimizer": SGD,
            "action_optimizer": SGD,
            "marginals": ExactMarginals(),
        }
        prices = {name: betas for name, betas in named.items() if name.startswith("beta")}
        own: dict[str, Any] = named | paper if rule == PAPER else prices
        return Population(task, AGENTS, percepts=self.percepts, seed=0, **own)


class Course(CurveMonitor):
    """Keeps the terms of J of all agents at each look, (R,) each, and the updates before it."""

    def __init__(self, every_n_updates: int) -> None:
        super().__init__(every_n_updates)
        self.updates: list[int] = []
        self.terms: list[Objective[Tensor]] = []

    def look(self, trainer: pl.Trainer, agent: Agent) -> None:
        """Evaluates all agents."""
        learner = learner_of(trainer.lightning_module)
        if self.updates[-1:] != [learner.updates]:
            self.updates.append(learner.updates)
            self.terms.append(learner.evaluate_members())


@dataclass(frozen=True)
class Training:
    """How agents of several regimes learnt by one rule, `AGENTS` of each regime in a row.

    Attributes:
        rule: Its name.
        task: What the agents do.
        regimes: Prices and rates.
        population: The agents as they ended.
        course: J and its terms on the way.
        references: The optima at the prices.
        hit_rates: Share of the agents of each regime that reached the optimum.
    """

    rule: str
    task: FiniteTask
    regimes: tuple[Regime, ...]
    population: Population
    course: Course
    references: Mapping[Prices, Reference]
    hit_rates: Mapping[Prices, float | None]

    def best(self, regime: Regime) -> int:
        """The agent of highest J of a regime."""
        start = AGENTS * self.regimes.index(regime)
        own = self.population.objectives()[start : start + AGENTS]
        return start + int(own.argmax())

    def values(self) -> list[Value]:
        """J and the informations of each regime's best agent beside those of the optimum."""
        return [value for regime in self.regimes for value in self._values(regime)]

    def _values(self, regime: Regime) -> list[Value]:
        terms = self.population.evaluate_members().map(lambda t: t[self.best(regime)].item())
        reference, name = self.references[regime.prices], f"{self.rule}, {regime.name}"
        rates = [
            Value(
                f"{name}: {symbol} in bits",
                bits(float(getattr(reference.optimum, term))),
                bits(getattr(terms, term)),
            )
            for term, symbol in INFORMATIONS.items()
        ]
        found = AGENTS * (self.hit_rates[regime.prices] or 0.0)
        return [
            Value(f"{name}: J", reference.objective, terms.objective, reference.bound),
            *rates,
            Value(f"{name}: at the optimum, of {AGENTS}", None, found),
        ]


def train(experiment: Experiment, rule: str, folder: str = ".") -> tuple[Training, pl.Trainer]:
    """Trains by a rule, with a progress bar; curves and a table of all agents are left in a folder.

    Args:
        experiment: What to train.
        rule: One of `RULES`.
        folder: Where the run's own folder goes.
    """
    task, baseline = experiment.task(), BaselineMonitor()
    population = experiment.population(rule, task)
    course = Course(max(1, RULES[rule] // LOOKS))
    trainer = pl.Trainer(
        max_epochs=1,
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        default_root_dir=folder,
        callbacks=[baseline, PopulationMonitor(), course, UpdateBar()],
    )
    trainer.fit(population, RolloutDataModule(task, 1, RULES[rule]))
    _, fare = fares(population, baseline)
    regimes, references = experiment.regimes, baseline.references
    rates = {r.prices: fare[r.prices, (None, None)].hit_rate for r in regimes}
    training = Training(rule, task, regimes, population, course, references, rates)
    return training, trainer


PENG = "Peng, Genewein, Leibfried & Braun, IROS (2017), {}; reference: the optimum, which it draws"
EXPERIMENTS = {
    "predator-prey-trained": Experiment(
        "predator-prey, learnt from one encounter after the other",
        PENG.format("figure 2"),
        PredatorPrey,
        13,
        20,
        (Regime(8.0, 10.0, 0.006, 0.014),),
    ),
    "mugs-trained": Experiment(
        "a robot learns from its camera which mug to lift how",
        PENG.format("figures 4 and 5"),
        NaoMugs,
        4,
        4,
        (
            Regime(2.0, 3.0, 0.035, 0.7),
            Regime(2.0, 0.5, 0.001, 0.34),
            Regime(0.5, 0.5, 0.004, 0.028),
        ),
    ),
}
