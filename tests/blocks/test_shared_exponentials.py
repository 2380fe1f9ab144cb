"""Probabilities and their logarithms from the same exponentials."""

import math

import pytest
import torch
from torch import Tensor
from torch.distributions import Categorical
from torch.fx.experimental.proxy_tensor import make_fx

from bra.blocks.exponentials import aten, share_exponentials

X = torch.randn(4, 5, dtype=torch.double, generator=torch.Generator().manual_seed(0))


def by_categorical(x: Tensor) -> tuple[Tensor, Tensor]:
    given = Categorical(logits=x, validate_args=False)
    return given.logits, given.logits.exp()


def by_log_softmax(x: Tensor) -> tuple[Tensor, Tensor]:
    log_p = x.log_softmax(-1)
    return log_p, log_p.exp()


@pytest.fixture(params=[by_categorical, by_log_softmax])
def of_both(request):
    return request.param


def test_values_stay_and_half_of_the_exponentials_go(of_both) -> None:
    recorded = make_fx(of_both)(X)
    share_exponentials(recorded)
    targets = [node.target for node in recorded.graph.nodes]
    assert targets.count(aten.exp.default) == 1
    assert aten.logsumexp.default not in targets
    torch.testing.assert_close(recorded(X), of_both(X), rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3, 1e300])
def test_extreme_values(scale: float, of_both) -> None:
    recorded = make_fx(of_both)(X)
    share_exponentials(recorded)
    for found, expected in zip(recorded(X * scale), of_both(X * scale), strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-14)


def test_outcomes_that_are_impossible(of_both) -> None:
    x = X.clone()
    x[0, 1:] = x[1] = -math.inf
    recorded = make_fx(of_both)(X)
    share_exponentials(recorded)
    for found, expected in zip(recorded(x), of_both(x), strict=True):
        torch.testing.assert_close(found, expected, equal_nan=True)


def test_gradients_share_them_too(of_both) -> None:
    def gradient(x: Tensor) -> Tensor:
        (found,) = torch.autograd.grad(of_both(x)[0][:, 0].sum(), x)
        return found

    recorded = make_fx(gradient)(X.clone().requires_grad_())
    expected = recorded(X)
    share_exponentials(recorded)
    assert [node.target for node in recorded.graph.nodes].count(aten.exp.default) == 1
    torch.testing.assert_close(recorded(X), expected, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize(
    "function",
    [
        lambda x: (x - x.logsumexp(0)).exp(),  # of another shape than x
        lambda x: (x - x.logsumexp(1, keepdim=True)).square(),
        lambda x: (2 * x - x.logsumexp(1, keepdim=True)).exp(),
        lambda x: (x.logsumexp(1, keepdim=True) - x).exp(),
    ],
)
def test_other_operations_stay(function) -> None:
    recorded = make_fx(function)(X)
    code = recorded.code
    share_exponentials(recorded)
    assert recorded.code == code
