"""Methods that hit rates are counted of, and the worlds that they are counted on."""

import dataclasses
import functools
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from rows_of_hits import (
    COOLED,
    PROTOCOL,
    RIVALS,
)
from torch import Tensor
from torch.optim import SGD

from bra import Cooling, TableTask
from bra.channels import Multinomial
from bra.cli.command import BraCLI
from bra.tasks import FiniteTask
from bra.tasks.nao_mugs import NaoMugs
from bra.update_rules import ExactGradient, Projection, Rivals, ScoreFunction

CONFIGS = Path(__file__).parents[1] / "configs"
GROUP = 16
QUIET = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")

Prices = tuple[tuple[float, float], ...]


@dataclasses.dataclass(frozen=True)
class Method:
    """A way to train.

    Attributes:
        config: Configuration that it is a variation of.
        updates: Length of a run.
        changes: Arguments of `Population` in place of the configuration's.
        groups: Populations of 16 to be trained at least; 0 for single agents only.
    """

    config: str
    updates: int
    changes: dict[str, Any] = dataclasses.field(default_factory=dict)
    groups: int = 0


def variations(whole: Method, cooling: Cooling, known: bool) -> dict[str, Method]:
    """The projection rule without each of its parts, and the gradient with and without them.

    Args:
        whole: The rule with a covering start and what else the configuration has.
        cooling: Of the methods that have it.
        known: Whether the signals are, so that J has an exact gradient and rivals can compete.
    """

    def without(groups: int = 0, **changes: Any) -> Method:
        plain = {"cooling": None, "update_rule": Projection()}
        return dataclasses.replace(whole, changes=plain | changes, groups=groups)

    gradient = {"update_rule": ExactGradient()}
    methods = {
        "exact gradient": without(action=Multinomial, **gradient),
        "exact gradient, covering, cooling": without(cooling=cooling, **gradient),
        "projection": without(action=Multinomial),
        "projection, covering": without(),
        "projection, cooling": without(action=Multinomial, cooling=cooling),
        COOLED: without(0 if known else whole.groups, cooling=cooling),
        RIVALS: without(whole.groups, update_rule=Projection(rivals=Rivals())),
    }
    unknown = {name for name in methods if "exact" in name or "rivals" in name}
    return methods if known else {n: m for n, m in methods.items() if n not in unknown}


def paper_rule(config: str, rates: Sequence[tuple[float, float]]) -> Method:
    """One encounter per update and plain ascent from a uniform start, at rates for all prices."""
    perception_rate, action_rate = (list(column) for column in zip(*rates, strict=True))
    changes = {
        "action": Multinomial,
        "cooling": None,
        "update_rule": ScoreFunction(),
        "compile": True,
        "perception_optimizer": SGD,
        "action_optimizer": SGD,
        "perception_rate": perception_rate,
        "action_rate": action_rate,
    }
    return Method(config, 100_000, changes)


def worlds() -> dict[str, tuple[Prices, dict[str, Method]]]:
    """Prices and methods of each world but the random tables."""
    prey = ((8.0, 10.0), (8.0, 1.0), (1.0, 10.0), (1.0, 1.0), (0.5, 0.5))
    mugs = ((2.0, 3.0), (2.0, 0.5), (0.5, 0.5))
    prey_ways = variations(
        Method("predator_prey.yaml", 2000, groups=16), Cooling(16.0, 800, [0.25, 4.0]), True
    )
    mug_ways = variations(
        Method("nao_mugs_high.yaml", 3000, groups=16), Cooling(16.0, 900, 4.0), True
    )
    jitter_ways = variations(
        Method("nao_mugs_jitter.yaml", 3000, groups=4), Cooling(16.0, 900), False
    )
    critic = "critic, taken actions only"
    fixed = {"task": NaoMugs(contrast=True)}
    rates = ((0.035, 0.7), (0.001, 0.34), (0.004, 0.028))
    own = paper_rule("nao_mugs_high.yaml", rates).changes
    kept = {name: own[name] for name in ("compile", "perception_rate", "action_rate")}
    mug_protocol = Method("nao_mugs_online/high.yaml", 100_000, kept)
    return {
        "predator-prey": (
            prey,
            {PROTOCOL: Method("predator_prey_online.yaml", 100_000, {"compile": True})}
            | {"paper's rule": paper_rule("predator_prey.yaml", [(0.006, 0.014)] * len(prey))}
            | prey_ways
            | {critic: Method("predator_prey_critic.yaml", 3000)},
        ),
        "mugs": (
            mugs,
            {PROTOCOL: mug_protocol, "paper's rule": paper_rule("nao_mugs_high.yaml", rates)}
            | mug_ways
            | {critic: Method("nao_mugs_critic.yaml", 8000, fixed)},
        ),
        "mugs, jittered": (mugs, jitter_ways | {critic: Method("nao_mugs_critic.yaml", 8000)}),
    }


def random_tables(count: int, seed: int) -> Iterator[tuple[TableTask, int, float, float]]:
    """Tasks with |X| and prices: 3 to 15 states, 2 to 12 actions, 2 to 16 percepts.

    Utilities are uniform, normal, sparse (three of ten), or one right action per state and a little
    for the others. Priors are uniform for four tables, then for four tables drawn from a Dirichlet
    distribution of parameter 1, and more skewed for every other such four. β is between 0.3 and 20,
    log-uniformly.
    """
    generator = torch.Generator().manual_seed(seed)

    def whole(low: int, high: int) -> int:
        return int(torch.randint(low, high + 1, (), generator=generator))

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator, dtype=torch.double)

    for number in range(count):
        states, actions, percepts = whole(3, 15), whole(2, 12), whole(2, 16)
        match number % 4:
            case 0:
                utilities = 5 * uniform(states, actions)
            case 1:
                utilities = torch.randn(states, actions, generator=generator, dtype=torch.double)
            case 2:
                utilities = 5 * (uniform(states, actions) < 0.3) * uniform(states, actions)
            case _:
                right = torch.arange(states).unsqueeze(-1) % actions == torch.arange(actions)
                utilities = 3 * right + 0.3 * uniform(states, actions)
        skew = number // 4 % 2 * (1 + number // 8 % 2)
        weights = (-uniform(states).clamp_min(1e-3).log()) ** skew
        beta_1, beta_2 = (0.3 * (20 / 0.3) ** uniform(2)).tolist()
        yield TableTask(utilities, prior=weights / weights.sum()), percepts, beta_1, beta_2


@functools.cache
def configuration(config: str) -> tuple[FiniteTask, dict[str, Any], int]:
    """Task, arguments of a population, and batch size of a configuration."""
    monitors = ("information", "baseline", "population", "behaviour", "summary", "frames")
    with tempfile.TemporaryDirectory() as folder:
        made = BraCLI(
            "fit",
            [
                *(f"--config={CONFIGS / config}", "--model.replicas=2"),
                *("--trainer.max_steps=0", f"--trainer.default_root_dir={folder}"),
                *(f"--{name}=null" for name in monitors),
                *(f"--trainer.{switch}=false" for switch in QUIET),
            ],
        )
    recipe = {part: value for part, value in made.model.recipe.items() if part != "task"}
    return made.model.task, recipe, made.datamodule.batch_size
