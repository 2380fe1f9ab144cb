"""Agent-updates per second of the paper's rule: blocks of updates beside JAX and NumPy.

    python benchmarks/throughput.py [--sizes 1 16 256 2048] [--repeats 7] [--device cpu]
        [--output throughput]

Needs JAX: pip install "bra[benchmarks]". Everybody makes the same update, that of
`configs/predator_prey_online.yaml` in float32: one encounter per agent, drawn anew, exact
marginals, plain gradient ascent with a rate for each channel.

plain JAX: the same with `jax.random.categorical` and `jax.value_and_grad`, as it is written first.
    It has the loss of JAX's rule and differs in its draws alone.
JAX: what one would write by hand for this one rule, `jax.vmap` over agents and `jax.lax.scan` over
    updates. Outcomes are drawn as bra draws them, by the inverse of the distribution function from
    one uniform number each, which is faster than `jax.random.categorical`.
NumPy: a loop in Python with the derivatives by hand, one agent after the other.
eager: updates one by one, uncompiled, in `Trainer.fit`, without monitors.
blocks: blocks of 1 000 updates and their worlds, without a trainer.
Trainer: the same in `Trainer.fit`, with counters, checks, data loader, loops and the monitors of
    the command at their defaults: optimum, curves, pictures and TensorBoard, in runs of some five
    seconds, of which the optimum and the pictures take one or two.
projection, eager projection: the projection rule with Adam, in `Trainer.fit` without monitors.

Before anything is timed, the rules of JAX and NumPy are checked to have bra's gradient at the same
encounters. On the CPU all have one thread, and one core. Contestants take turns; medians are
compared. Prints a Markdown table; writes throughput.csv and throughput.png into a folder.
"""

import os

os.environ["XLA_FLAGS"] = (  # read when JAX starts
    "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1 "
    + os.environ.get("XLA_FLAGS", "")
)

import argparse
import csv
import io
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import matplotlib.pyplot as plt
import numpy as np
import torch
from lightning.pytorch.callbacks import ProgressBar
from torch.optim import SGD, Adam

import bra
from bra import Agent, Population, PredatorPrey, RolloutDataModule
from bra.blocks import Blocks
from bra.channels import MLP, Multinomial
from bra.cli.command import quieten
from bra.marginals import ExactMarginals
from bra.randomness.draws import Uniform
from bra.randomness.keys import update_key
from bra.tasks import World
from bra.tasks.base import Block
from bra.tasks.datamodule import WorldStream
from bra.update_rules import Projection, ScoreFunction, UpdateRule

try:
    import jax
    import jax.numpy as jnp
except ImportError:
    sys.exit('error: JAX is missing; pip install "bra[benchmarks]"')

PERCEPTS, HIDDEN = 13, 20
BETA_PERCEPTION, BETA_ACTION = 8.0, 10.0
PERCEPTION_RATE, ACTION_RATE = 0.006, 0.014
SECONDS, MONITORED = 0.3, 5.0
"""What a measurement is to take, roughly, without monitors and with them."""
NAMES = (
    *("JAX", "plain JAX", "NumPy", "eager", "blocks", "Trainer"),
    *("projection", "eager projection"),
)


def make_agents(
    size: int, compile: bool, rule: UpdateRule | None = None, optimizer: Any = SGD
) -> Agent | Population:
    """Agents of the paper, of seeds 0, 1, …."""
    own = {
        "compile": compile,
        "perception": partial(MLP, hidden=[HIDDEN], bias=False),
        "action": Multinomial,
        "percepts": PERCEPTS,
        "beta_perception": BETA_PERCEPTION,
        "beta_action": BETA_ACTION,
        "update_rule": rule or ScoreFunction(),
        "marginals": ExactMarginals(),
        "perception_optimizer": partial(optimizer, lr=PERCEPTION_RATE),
        "action_optimizer": partial(optimizer, lr=ACTION_RATE),
        "seed": 0,
    }
    if size == 1:
        return Agent(PredatorPrey(), **own)
    return Population(PredatorPrey(), replicas=size, **own)


class JaxRule:
    """The same rule, written for JAX.

    Parameters are (V, W, η) of one agent: (20, 4), (13, 20) and (8, 13).
    """

    def __init__(self) -> None:
        task = PredatorPrey()
        self.signals = jnp.asarray(task.observations.numpy())
        self.utilities = jnp.asarray(task.utilities.float().numpy())
        self.prior = jnp.asarray(task.prior.float().numpy())
        self.gradient = jax.grad(self.loss)

    def loss(self, parameters: Any, state: Any, numbers: Any) -> Any:
        """−(log p(x|ξ) + log p(a|x)) j of one encounter, j held constant.

        Args:
            parameters: V, W and η.
            state: ω.
            numbers: What percept and action are drawn with, two for `draw`.
        """
        first, second, eta = parameters

        def perceive(signals: Any) -> Any:
            return jax.nn.log_softmax(jnp.tanh(signals @ first.T) @ second.T)

        log_percept = perceive(self.signals[state])
        log_actions = jax.nn.log_softmax(jnp.concatenate([jnp.zeros((1, PERCEPTS)), eta]).T)
        percept = self.draw(log_percept, numbers[0])
        action = self.draw(log_actions[percept], numbers[1])
        scores = (log_percept[percept], log_actions[percept, action])
        percept_marginal = self.prior @ jnp.exp(perceive(self.signals))
        action_marginal = percept_marginal @ jnp.exp(log_actions)
        perception_cost = scores[0] - jnp.log(percept_marginal[percept])
        action_cost = scores[1] - jnp.log(action_marginal[action])
        j = self.utilities[state, action]
        j = j - perception_cost / BETA_PERCEPTION - action_cost / BETA_ACTION
        return -(scores[0] + scores[1]) * jax.lax.stop_gradient(j)

    def numbers(self, key: Any) -> Any:
        """Three numbers in [0, 1)."""
        return jax.random.uniform(key, (3,))

    def draw(self, log_probabilities: Any, number: Any) -> Any:
        """The first outcome whose cumulated probability exceeds the number."""
        cumulated = jnp.cumsum(jnp.exp(log_probabilities))
        return (cumulated <= number * cumulated[-1]).sum()

    def update(self, parameters: Any, key: Any, count: Any) -> Any:
        """One update of one agent.

        Args:
            parameters: V, W and η.
            key: Of the agent.
            count: Number of the update.
        """
        numbers = self.numbers(jax.random.fold_in(key, count))
        state = self.draw(jnp.log(self.prior), numbers[0])
        gradients = self.gradient(parameters, state, numbers[1:])
        rates = (PERCEPTION_RATE, PERCEPTION_RATE, ACTION_RATE)
        return tuple(p - r * g for p, r, g in zip(parameters, rates, gradients, strict=True))

    @partial(jax.jit, static_argnums=(0, 3))
    def updates(self, parameters: Any, keys: Any, count: int) -> Any:
        """Several updates of several agents."""

        def step(parameters: Any, number: Any) -> tuple[Any, None]:
            return jax.vmap(self.update, (0, 0, None))(parameters, keys, number), None

        return jax.lax.scan(step, parameters, jnp.arange(count))[0]


class NumPyRule:
    """The same rule for one agent in NumPy, with the derivatives by hand."""

    def __init__(self) -> None:
        task = PredatorPrey()
        self.signals = task.observations.numpy().astype(np.float32)
        self.utilities = task.utilities.float().numpy()
        self.prior = task.prior.float().numpy()
        self.cumulated = self.prior.cumsum()

    def gradient(self, first: Any, second: Any, eta: Any, state: int, numbers: Any) -> Any:
        """Of −(log p(x|ξ) + log p(a|x)) j of one encounter, j held constant."""
        hidden = np.tanh(self.signals @ first.T)
        log_percepts = log_softmax(hidden @ second.T)
        percepts = np.exp(log_percepts)
        log_actions = log_softmax(np.vstack([np.zeros((1, PERCEPTS), np.float32), eta]).T)
        actions = np.exp(log_actions)
        percept = self.draw(percepts[state], numbers[0])
        action = self.draw(actions[percept], numbers[1])
        marginal = self.prior @ percepts
        perception_cost = log_percepts[state, percept] - np.log(marginal[percept])
        action_cost = log_actions[percept, action] - np.log(marginal @ actions[:, action])
        j = self.utilities[state, action]
        j = j - perception_cost / BETA_PERCEPTION - action_cost / BETA_ACTION
        by_logits = j * percepts[state]
        by_logits[percept] -= j
        by_action = j * actions[percept]
        by_action[action] -= j
        by_hidden = (by_logits @ second) * (1 - hidden[state] ** 2)
        by_eta = np.zeros_like(eta)
        by_eta[:, percept] = by_action[1:]
        return np.outer(by_hidden, self.signals[state]), np.outer(by_logits, hidden[state]), by_eta

    def draw(self, probabilities: Any, number: Any) -> int:
        """The first outcome whose cumulated probability exceeds the number."""
        cumulated = probabilities.cumsum()
        return min(int((cumulated <= number * cumulated[-1]).sum()), len(probabilities) - 1)


def log_softmax(logits: Any) -> Any:
    """Of the last dimension."""
    logits = logits - logits.max(-1, keepdims=True)
    return logits - np.log(np.exp(logits).sum(-1, keepdims=True))


def numpy_run(rule: NumPyRule, size: int) -> "Run":
    """Updates by NumPy, agent by agent."""
    stacks = [stack.detach().numpy() for stack in stacked_parameters(make_agents(size, False))]
    agents = [[s.copy() for s in of_one] for of_one in zip(*stacks, strict=True)]
    rates = (PERCEPTION_RATE, PERCEPTION_RATE, ACTION_RATE)
    generator = np.random.default_rng(0)

    def run(updates: int) -> float:
        start = time.perf_counter()
        for parameters in agents:
            for numbers in generator.random((updates, 3), np.float32):
                state = rule.draw(rule.prior, numbers[0])
                gradients = rule.gradient(*parameters, state, numbers[1:])
                for parameter, gradient, rate in zip(parameters, gradients, rates, strict=True):
                    parameter -= rate * gradient
        return time.perf_counter() - start

    return run


class PlainJaxRule(JaxRule):
    """The same as it is written first, with what JAX offers for drawing."""

    def __init__(self) -> None:
        super().__init__()
        with_value = jax.value_and_grad(self.loss)
        self.gradient = lambda *inputs: with_value(*inputs)[1]

    def numbers(self, key: Any) -> Any:
        """Three keys."""
        return jax.random.split(key, 3)

    def draw(self, log_probabilities: Any, number: Any) -> Any:
        """A draw with a key."""
        return jax.random.categorical(number, log_probabilities)


def stacked_parameters(agents: Agent | Population) -> list[torch.Tensor]:
    """V, W and η of every agent."""
    channels = (agents.perception, agents.action)
    found = [parameter for channel in channels for parameter in channel.parameters()]
    return found if isinstance(agents, Population) else [p.unsqueeze(0) for p in found]


def to_jax(parameters: Sequence[torch.Tensor]) -> tuple[Any, ...]:
    """The same as arrays of JAX."""
    return tuple(jnp.asarray(parameter.detach().cpu().numpy()) for parameter in parameters)


def check_gradients(rule: JaxRule, own: NumPyRule, size: int = 64) -> None:
    """Makes sure that all sides climb the same gradient at the same encounters."""
    population = make_agents(size, compile=False)
    with torch.no_grad():  # actions that are all alike would hide much
        population.action.eta.normal_(generator=torch.Generator().manual_seed(0))
    world = WorldStream(population.task, 1, population.world_seeds, "world")[0]
    population.find_gradient(world)
    numbers = [Uniform(update_key(seed, "update", 0))((2,)) for seed in population.world_seeds]
    stacks = stacked_parameters(population)
    found = jax.vmap(rule.gradient)(
        to_jax(stacks), jnp.asarray(world.state[:, 0].numpy()), jnp.asarray(torch.stack(numbers))
    )
    by_hand = [
        own.gradient(
            *(s[i].detach().numpy() for s in stacks), int(world.state[i]), numbers[i].numpy()
        )
        for i in range(size)
    ]
    for stack, gradient, third in zip(stacks, found, zip(*by_hand, strict=True), strict=True):
        np.testing.assert_allclose(np.asarray(gradient), stack.grad, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(np.stack(third), stack.grad, rtol=1e-4, atol=1e-6)


Run = Callable[[int], float]
"""Makes so many updates, and tells the seconds that they took."""


def jax_run(rule: JaxRule, size: int) -> Run:
    """Updates by JAX; compiles for each new number of them."""
    parameters = to_jax(stacked_parameters(make_agents(size, compile=False)))
    keys = jax.random.split(jax.random.key(0), size)

    def run(updates: int) -> float:
        start = time.perf_counter()
        jax.block_until_ready(rule.updates(parameters, keys, updates))
        return time.perf_counter() - start

    return run


def block_run(size: int, device: torch.device) -> Run:
    """Blocks of updates without a trainer."""
    agents = make_agents(size, compile=True).to(device)
    seeds = getattr(agents, "world_seeds", None) or agents.seed
    worlds = WorldStream(agents.task, 1, seeds, "world")
    optimizers, _ = agents.configure_optimizers()
    blocks = Blocks(numbers=5 * size)

    def run(updates: int) -> float:
        start = time.perf_counter()
        for first in range(agents.updates, agents.updates + updates, blocks.capacity):
            count = min(blocks.capacity, agents.updates + updates - first)
            block = worlds[range(first, first + count)]
            block = Block(World(*(part.to(device) for part in block.world)), *block[1:])
            prices = torch.tensor([BETA_PERCEPTION, BETA_ACTION], device=device)
            prices = prices.reshape(1, 2, 1).expand(count, 2, size)
            rates = torch.tensor([PERCEPTION_RATE, ACTION_RATE], device=device).expand(count, 2)
            blocks.make(
                agents.all_agents(optimizers, None), block, prices, partial(torch.clone, rates)
            )
        agents.updates += updates
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        return time.perf_counter() - start

    return run


class Clock(pl.Callback):
    """Takes the time from the first update to the last."""

    def on_train_start(self, *_: Any) -> None:
        """Starts."""
        self.start = time.perf_counter()

    def on_train_end(self, *_: Any) -> None:
        """Stops."""
        self.seconds = time.perf_counter() - self.start


def trainer_run(agents: Agent | Population, device: torch.device, watched: bool = False) -> Run:
    """Updates in `Trainer.fit`, with the monitors of the command or without."""

    def run(updates: int) -> float:
        clock, agents.run = Clock(), None  # a run of its own
        monitors = [m for m in bra.monitors() if watched and not isinstance(m, ProgressBar)]
        with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()):
            trainer = pl.Trainer(
                max_epochs=1,
                accelerator="gpu" if device.type == "cuda" else "cpu",
                devices=1,
                limit_val_batches=0,
                callbacks=[clock, *monitors],
                default_root_dir=folder,
                enable_checkpointing=False,
                enable_progress_bar=False,
                enable_model_summary=False,
            )
            trainer.fit(agents, RolloutDataModule(agents.task, 1, updates))
        return clock.seconds

    return run


@dataclass(frozen=True)
class Result:
    """Agent-updates per second of one contestant."""

    name: str
    agents: int
    median: float
    lowest: float
    highest: float


def measure(
    size: int, rules: tuple[JaxRule, JaxRule, NumPyRule], device: torch.device, repeats: int
) -> list[Result]:
    """Lets the contestants take turns."""
    rule, plain, own = rules
    with_adam = {"rule": Projection(), "optimizer": Adam}
    makers = (
        lambda: jax_run(rule, size),
        lambda: jax_run(plain, size),
        lambda: numpy_run(own, size),
        lambda: trainer_run(make_agents(size, False), device),
        lambda: block_run(size, device),
        lambda: trainer_run(make_agents(size, True), device, watched=True),
        lambda: trainer_run(make_agents(size, True, **with_adam), device),
        lambda: trainer_run(make_agents(size, False, **with_adam), device),
    )
    runs = [make() for make in makers]
    counts = []
    for run in runs:
        run(3)
        run(20)
        counts.append(max(20, round(20 * SECONDS / run(20))))
        run(counts[-1])  # JAX compiles for this number
    of_blocks, watched = NAMES.index("blocks"), NAMES.index("Trainer")
    counts[watched] = round(counts[of_blocks] * MONITORED / SECONDS)
    # Each fit records anew what it compiles, or finds, for which long runs make up.
    projected = NAMES.index("projection")
    counts[projected] = counts[watched] // 8
    seconds: list[list[float]] = [[] for _ in runs]
    for _ in range(repeats):
        for run, count, times in zip(runs, counts, seconds, strict=True):
            times.append(run(count))
    results = []
    for name, count, times in zip(NAMES, counts, seconds, strict=True):
        rates = [size * count / taken for taken in times]
        results.append(Result(name, size, statistics.median(rates), min(rates), max(rates)))
    return results


def print_table(results: Sequence[Result]) -> None:
    """A row per size: agent-updates per second, and their ratios to JAX."""
    medians = {(result.agents, result.name): result.median for result in results}
    others = ("NumPy", "blocks", "Trainer")
    print(f"| agents | {' | '.join(NAMES)} | {' | '.join(f'{n} / JAX' for n in others)} |")
    print("|" + "---|" * (1 + len(NAMES) + len(others)))
    for size in sorted({result.agents for result in results}):
        rates = [medians[size, name] for name in NAMES]
        ratios = [f"{medians[size, name] / rates[0]:.2f}" for name in others]
        shown = [f"{rate:,.0f}".replace(",", " ") for rate in rates]
        print(f"| {size} | {' | '.join(shown + ratios)} |", flush=True)


def write_results(results: Sequence[Result], folder: Path) -> None:
    """The table as a file, and the picture."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "throughput.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(vars(results[0]))
        writer.writerows(vars(result).values() for result in results)
    figure, axes = plt.subplots(figsize=(8.0, 5.2), layout="constrained")
    markers = dict(zip(NAMES, "svx^o*PX", strict=True))
    labels = {
        "JAX": "JAX, vmap + scan",
        "plain JAX": "the same with jax.random.categorical",
        "NumPy": "NumPy, a loop",
        "eager": "update by update, in Trainer.fit",
        "blocks": "blocks of updates",
        "Trainer": "blocks of updates, in Trainer.fit",
        "projection": "projection rule with Adam, blocks, in Trainer.fit",
        "eager projection": "projection rule with Adam, update by update",
    }
    for name in NAMES:
        own = [result for result in results if result.name == name]
        sizes, rates = [r.agents for r in own], [r.median for r in own]
        axes.plot(sizes, rates, marker=markers[name], label=labels[name])
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    ticks = sorted({result.agents for result in results})
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.set_xlabel("agents R")
    axes.set_ylabel("agent-updates per second")
    axes.set_title("The paper's rule on predator-prey, one encounter per update")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    figure.savefig(folder / "throughput.png", dpi=150)


def main() -> None:
    """Checks, measures, prints and writes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[1, 16, 256, 2048])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--device", type=torch.device, default=torch.device("cpu"))
    parser.add_argument("--output", type=Path, default=Path("throughput"))
    options = parser.parse_args()
    quieten()
    torch.set_num_threads(1)
    if options.device.type == "cpu" and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    rules = (JaxRule(), PlainJaxRule(), NumPyRule())
    check_gradients(rules[0], rules[2])
    results = []
    for size in options.sizes:
        results += measure(size, rules, options.device, options.repeats)
    print_table(results)
    write_results(results, options.output)


if __name__ == "__main__":
    main()
