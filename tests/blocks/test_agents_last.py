"""Operations with the agents last do what `torch.func.vmap` does."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.fx import GraphModule
from torch.fx.experimental.proxy_tensor import make_fx

from bra.blocks.agents_last import FEW, AgentsLast

AGENTS = 5
ROWS = torch.tensor([2, 0, 2])

OPERATIONS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "elements, a number of each": lambda x, y: x * y.double().sum() + torch.ones(3, 1),
    "product": lambda x, y: x @ y.T,
    "product with what is shared": lambda x, y: torch.ones(2, 3) @ x + y[0],
    "batches of products": lambda x, y: x.expand(2, 3, 4) @ y.T.expand(2, 4, 3),
    "softmax": lambda x, y: x.softmax(-1) + y.log_softmax(0),
    "reductions": lambda x, y: x.mean() + y.sum(-2).logsumexp(-1) + x.amax(),
    "reductions of numbers": lambda x, y: x.sum().mean() + y[0, 0].sum() + y[1, 1].logsumexp(0),
    "running sum": lambda x, y: x.cumsum(-1) - y.cumsum(0),
    "views": lambda x, y: torch.cat([x.T.reshape(-1), y[1:, None, :2].squeeze(-2).flatten()]),
    "rows": lambda x, y: x[ROWS] + y[x.argmax(0)[:3]],
    "rows counted from the end": lambda x, y: x[-1 - ROWS] * y,
    "numbers": lambda x, y: x[ROWS, y[:3].argmax(-1)],
    "columns": lambda x, y: x[:, y.argmax(0)],
    "gather": lambda x, y: x.gather(1, y.argsort(1)[:, :2]),
    "scatter": lambda x, y: x.scatter_add(1, y.argsort(1)[:, :2] // 2, y[:, :2]),
    "index_put": lambda x, y: x.index_put((y.argmax(0)[:3],), y, accumulate=True),
    "index_put in place of": lambda x, y: x.index_put((ROWS[:2],), y[:2] * 0),
    "sort, by vmap": lambda x, y: x.sort(-1).values + y,
}


def run(recorded: GraphModule, own: list[bool], *inputs: Tensor) -> Tensor:
    """Results (R, …) of what each agent has of its own, (R, …) and first, and of what is shared."""
    moved = [x.movedim(0, -1) if is_own else x for x, is_own in zip(inputs, own, strict=True)]
    (found,) = AgentsLast(recorded, len(inputs[0]))(own, moved, [True])
    return found.movedim(-1, 0)


def record(function: Callable[..., Tensor], *inputs: Tensor) -> GraphModule:
    recorded: GraphModule = make_fx(lambda *own: (function(*own),))(*inputs)
    return recorded


@pytest.mark.parametrize("agents", [1, AGENTS, FEW + 1])
@pytest.mark.parametrize("name", OPERATIONS)
def test_agents_last_is_vmap(name: str, agents: int) -> None:
    generator = torch.Generator().manual_seed(0)
    x, y = torch.randn(2, agents, 3, 4, generator=generator)
    recorded = record(OPERATIONS[name], x[0], y[0])
    found = run(recorded, [True, True], x, y)
    expected = torch.stack([OPERATIONS[name](*own) for own in zip(x, y, strict=True)])
    torch.testing.assert_close(found, expected)


def test_what_is_shared_stays_shared() -> None:
    x, shared = torch.randn(AGENTS, 3), torch.randn(3)
    recorded = make_fx(lambda own, all: (own * all, all + 1))(x[0], shared)
    found, same = AgentsLast(recorded, AGENTS)([True, False], [x.T, shared], [True, False])
    torch.testing.assert_close(found.T, x * shared)
    torch.testing.assert_close(same, shared + 1)


def test_operations_that_leave_out_outputs() -> None:
    frames, weight = torch.randn(AGENTS, 2, 1, 5, 3), torch.randn(AGENTS, 2, 1, 2, 2)

    def gradient(frame: Tensor, weight: Tensor) -> Tensor:  # asks for no gradient of frames
        loss = torch.nn.functional.conv2d(frame, weight).square().sum()
        (found,) = torch.autograd.grad(loss, weight)
        return found

    weight.requires_grad_()
    recorded = record(gradient, frames[0], weight[0].detach().requires_grad_())
    found = run(recorded, [True, True], frames, weight)
    expected = torch.stack([gradient(f, w) for f, w in zip(frames, weight.unbind(), strict=True)])
    torch.testing.assert_close(found, expected)
