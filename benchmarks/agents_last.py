"""Where the agents stand: one update of many, done in three ways, each compiled.

    python benchmarks/agents_last.py [--sizes 16 256 2048] [--repeats 15]

The update of one agent, loss, gradient and step, is recorded as blocks record it: that of
`configs/predator_prey_online.yaml`, and the projection rule with Adam. R agents do it by

vmap first: `torch.func.vmap` over agents in the first dimension,
vmap last: `torch.func.vmap` over agents in the last one, of a graph in which products of matrices,
    running sums and everything by index are sums of elements (`DECOMPOSED`),
interpreter: `bra.blocks.agents_last`, as blocks have it, for all agents in one group,

through `torch.compile(fullgraph=True)` without the loop around it, on one thread. What comes out is
held against the first way. Ways take turns; prints medians in microseconds as a Markdown table.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from by_hand import PRICES, make_agents
from torch import Tensor
from torch.fx.experimental.proxy_tensor import make_fx
from torch.optim import Adam

from bra.blocks import Blocks
from bra.blocks import blocks as module
from bra.blocks.agents_last import AgentsLast
from bra.blocks.loop import Inputs
from bra.blocks.recording import Recorded
from bra.cli.command import quieten
from bra.tasks.datamodule import WorldStream
from bra.update_rules import Projection

aten = torch.ops.aten
RULES = {"on-line": {}, "projection, Adam": {"rule": Projection(), "optimizer": Adam}}
NAMES = ("vmap first", "vmap last", "interpreter")


def product(a: Tensor, b: Tensor) -> Tensor:
    """Σ_k a_ik b_kj."""
    return (a.unsqueeze(-1) * b.unsqueeze(-3)).sum(-2)


def running_sum(x: Tensor, dim: int) -> Tensor:
    """Σ_{j≤i} x_j."""
    dim %= x.ndim
    count = torch.arange(x.shape[dim])
    upto = (count <= count.unsqueeze(1)).reshape(*count.shape * 2, *[1] * (x.ndim - dim - 1))
    return (x.unsqueeze(dim) * upto).sum(dim + 1)


def one_of(index: Tensor, count: int) -> Tensor:
    """Whether each index is 0, 1, …, in a new last dimension."""
    return index.unsqueeze(-1) == torch.arange(count)


def gather(x: Tensor, dim: int, index: Tensor) -> Tensor:
    """What an index picks along a dimension."""
    picks = one_of(index.movedim(dim, -1), x.shape[dim])
    return (picks * x.movedim(dim, -1).unsqueeze(-2)).sum(-1).movedim(-1, dim)


def scatter_add(x: Tensor, dim: int, index: Tensor, source: Tensor) -> Tensor:
    """The other way round."""
    picks = one_of(index.movedim(dim, -1), x.shape[dim])
    return x + (picks * source.movedim(dim, -1).unsqueeze(-1)).sum(-2).movedim(-1, dim)


def pick(x: Tensor, indices: list[Tensor | None]) -> Tensor:
    """Rows by one index; by several, as torch has it."""
    if len(indices) > 1 or indices[0] is None:
        return NotImplemented
    (index,) = indices
    picks = one_of(index, len(x)).reshape(*index.shape, len(x), *[1] * (x.ndim - 1))
    return (picks * x).sum(index.ndim)


DECOMPOSED = {
    aten.mm.default: product,
    aten.cumsum.default: running_sum,
    aten.gather.default: gather,
    aten.scatter_add.default: scatter_add,
    aten.index.Tensor: pick,
}


def recorded_update(size: int, rule: dict[str, Any]) -> tuple[Recorded, Inputs]:
    """The update of one agent, and inputs of R, all of them in one group."""
    module.groups_of = lambda size, _: [slice(0, size)]
    agents = make_agents(size, True, **rule)
    optimizers, _ = agents.configure_optimizers()
    for parameter in agents.parameters():
        parameter.grad = torch.zeros_like(parameter)
    for optimizer in optimizers:  # which then has its slots
        optimizer.step()
    seeds = agents.world_seeds or agents.seed
    block = WorldStream(agents.task, 1, seeds, "world")[range(1)]
    prices = torch.tensor(PRICES).reshape(1, 2, 1).expand(1, 2, size)
    return Blocks(5 * size)._recorded(agents.all_agents(optimizers, None), block, prices)


def ways(recorded: Recorded, inputs: Inputs) -> dict[str, Callable[[], tuple[Tensor, ...]]]:
    """The compiled update of each way, with inputs of its own."""
    prices, rates, states, signals = (stack[0] for stack in inputs.stacked)
    scales, keys, *constants = inputs.fixed
    flat = [*inputs.kept, prices, scales, rates, states, signals, torch.tensor(0), keys, *constants]
    own = inputs.own
    ones = [x[..., 0] if apart else x for x, apart in zip(flat, own, strict=True)]
    small = make_fx(recorded.graph, decomposition_table=DECOMPOSED)(*ones)
    first = [
        x.movedim(-1, 0).contiguous() if apart else x for x, apart in zip(flat, own, strict=True)
    ]
    outputs = len(recorded.graph(*ones))
    interpreter = AgentsLast(recorded.graph, inputs.agents)
    made = {
        "vmap first": (torch.vmap(recorded.graph, tuple(0 if o else None for o in own)), first),
        "vmap last": (torch.vmap(small, tuple(-1 if o else None for o in own), -1), flat),
        "interpreter": (make_fx(lambda *x: interpreter(own, x, [True] * outputs))(*flat), flat),
    }
    return {
        name: partial(torch.compile(update, fullgraph=True), *given)
        for name, (update, given) in made.items()
    }


def measure(size: int, rule: dict[str, Any], repeats: int) -> list[float]:
    """Median microseconds of each way."""
    torch._dynamo.reset()
    updates = ways(*recorded_update(size, rule))
    found = {name: update() for name, update in updates.items()}
    close = partial(torch.testing.assert_close, rtol=1e-4, atol=1e-5, check_dtype=False)
    for name in NAMES[1:]:
        for expected, other in zip(found["vmap first"], found[name], strict=True):
            last = expected.movedim(0, -1)
            close(other[..., : last.shape[-1]], last)
    times: dict[str, list[float]] = {name: [] for name in NAMES}
    for _ in range(repeats):
        for name, update in updates.items():
            calls, began = max(10, 20_000 // size), time.process_time()
            for _ in range(calls):
                update()
            times[name].append((time.process_time() - began) / calls * 1e6)
    return [statistics.median(times[name]) for name in NAMES]


def main() -> None:
    """Prints a row for each rule and size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[16, 256, 2048])
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    torch.set_num_threads(1)
    quieten()
    print(f"| rule | agents | {' | '.join(f'{name}, µs' for name in NAMES)} |")
    print("|" + "---|" * (2 + len(NAMES)))
    for name, rule in RULES.items():
        for size in options.sizes:
            cells = (
                f"{taken:,.0f}".replace(",", " ") for taken in measure(size, rule, options.repeats)
            )
            print(f"| {name} | {size} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
