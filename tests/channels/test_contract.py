"""What every channel owes, checked on one table of instances."""

import io
import math
from itertools import product

import numpy as np
import pytest
import torch
from channel_kinds import INSTANCES, make
from gymnasium.spaces import Discrete, Tuple
from torch.func import functional_call, stack_module_state, vmap

from bra.channels.base import check_channel
from bra.channels.distributions import probabilities

BATCH_SHAPES = [(), (5,), (2, 3)]


# One outcome leaves nothing to learn.
LEARNABLE = [name for name in INSTANCES if name != "table, one outcome"]


def make_typical(name, seed=0):
    """A channel off its start, where nothing is zero or uniform by construction."""
    channel = make(name, seed)
    channel(conditions(channel, (2,)))  # lazy layers get their shape
    with torch.no_grad():
        for parameter in channel.parameters():
            parameter.add_(0.3 * torch.randn_like(parameter))
    return channel


def conditions(channel, batch, seed=0):
    return draw(channel.condition_space, batch, torch.Generator().manual_seed(seed))


def draw(space, batch, generator):
    if isinstance(space, Tuple):
        return tuple(draw(part, batch, generator) for part in space)
    if isinstance(space, Discrete):
        return torch.randint(int(space.n), batch, generator=generator)
    if space.dtype == np.uint8:
        numbers = torch.randint(256, (*batch, *space.shape), generator=generator)
        return numbers.to(torch.uint8)
    return torch.randn((*batch, *space.shape), generator=generator)


def event_shape(channel):
    space = channel.outcome_space
    return () if isinstance(space, Discrete) else space.shape


def chi_square_p(counts, expected):
    """Probability of counts at least as far from what is expected."""
    statistic = ((counts - expected) ** 2 / expected).sum()
    return torch.special.gammaincc(torch.tensor((len(counts) - 1) / 2), statistic / 2).item()


@pytest.mark.parametrize(("name", "batch"), list(product(INSTANCES, BATCH_SHAPES)))
def test_shapes(name, batch):
    channel = make(name)
    given = conditions(channel, batch)
    distribution = channel(given)
    assert distribution.batch_shape == batch
    assert distribution.event_shape == event_shape(channel)
    outcome = distribution.sample((4,))
    assert outcome.shape == (4, *batch, *event_shape(channel))
    assert distribution.log_prob(outcome).shape == (4, *batch)
    if isinstance(channel.outcome_space, Discrete):
        assert not outcome.is_floating_point()
        assert probabilities(distribution).shape == (*batch, channel.outcome_space.n)


@pytest.mark.parametrize("name", INSTANCES)
def test_a_batch_is_its_elements(name):
    channel = make_typical(name)
    given = conditions(channel, (2, 3))
    distribution = channel(given)
    outcome = distribution.sample()
    together = distribution.log_prob(outcome)
    for index in np.ndindex(2, 3):
        one = tuple(part[index] for part in given) if isinstance(given, tuple) else given[index]
        alone = channel(one).log_prob(outcome[index])
        torch.testing.assert_close(alone, together[index], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", INSTANCES)
def test_honours_the_contract(name):
    check_channel(make(name))


@pytest.mark.parametrize("name", INSTANCES)
def test_probabilities_sum_to_one(name):
    channel = make_typical(name)
    distribution = channel(conditions(channel, (3,)))
    if distribution.has_enumerate_support:
        support = distribution.enumerate_support()
        total = distribution.log_prob(support).exp().sum(0)
        torch.testing.assert_close(total, torch.ones(3))
        torch.testing.assert_close(probabilities(distribution).sum(-1), torch.ones(3))
        return
    mean, scale = distribution.mean.detach(), distribution.stddev.detach()
    volume = math.prod(event_shape(channel))
    if volume == 1:
        steps = torch.linspace(-9, 9, 2001).reshape(-1, *[1] * mean.ndim)
        density = distribution.log_prob(mean + scale * steps).exp()
        width = scale.flatten() * (steps[1] - steps[0]).item()
        torch.testing.assert_close(density.sum(0) * width, torch.ones(3), rtol=1e-4, atol=1e-4)
        return
    # Importance sampling from normals 1.2 times as wide: E[p/q] = 1. Six standard errors,
    # 4 instances × 3 conditions: failure probability 2e-8.
    torch.manual_seed(0)
    noise = torch.randn(20_000, *mean.shape)
    log_q = -0.5 * noise**2 - (1.2 * scale * math.sqrt(2 * math.pi)).log()
    log_p = distribution.log_prob(mean + 1.2 * scale * noise).detach()
    ratio = (log_p - log_q.flatten(2).sum(-1)).exp()
    errors = (ratio.mean(0) - 1) / (ratio.std(0) / math.sqrt(len(ratio)))
    assert errors.abs().max() < 6


@pytest.mark.parametrize("name", LEARNABLE)
def test_samples_follow_the_probabilities(name):
    # Chi-square on 20 000 draws, rejected below p = 1e-7: failure probability under 1e-5 for all
    # instances and coordinates together.
    channel = make_typical(name)
    distribution = channel(conditions(channel, ()))
    torch.manual_seed(1)
    outcomes = distribution.sample((20_000,))
    if distribution.has_enumerate_support:
        expected = 20_000 * probabilities(distribution).detach()
        counts = torch.bincount(outcomes, minlength=len(expected))
        rare = expected < 5  # too few for the chi-square approximation: one cell
        counts = torch.cat([counts[~rare], counts[rare].sum(0, keepdim=True)])
        expected = torch.cat([expected[~rare], expected[rare].sum(0, keepdim=True)])
        kept = expected > 0
        assert chi_square_p(counts[kept], expected[kept]) > 1e-7
        return
    standard = (outcomes - distribution.mean) / distribution.stddev
    uniform = torch.special.ndtr(standard.detach()).reshape(20_000, -1)
    for coordinate in uniform.T:
        counts = torch.histc(coordinate, bins=20, min=0, max=1)
        assert chi_square_p(counts, torch.full((20,), 1000.0)) > 1e-7


@pytest.mark.parametrize("name", LEARNABLE)
def test_gradients_reach_every_parameter(name):
    channel = make(name)
    given = conditions(channel, (40,))
    torch.manual_seed(1)
    distribution = channel(given)
    weights = torch.randn(40)  # scores sum to something other than zero
    (weights * distribution.log_prob(distribution.sample())).sum().backward()
    assert list(channel.parameters())
    for key, parameter in channel.named_parameters():
        assert parameter.grad is not None, key
        assert parameter.grad.isfinite().all(), key
        assert parameter.grad.abs().max() > 0, key


@pytest.mark.parametrize("name", LEARNABLE)
def test_vmap_over_stacked_parameters_is_a_loop(name):
    channels = [make_typical(name, seed) for seed in range(3)]
    given = conditions(channels[0], (5,))
    outcome = channels[0](given).sample()
    parameters, buffers = stack_module_state(channels)

    def score(parameters, buffers):
        return functional_call(channels[0], (parameters, buffers), (given,)).log_prob(outcome)

    stacked = vmap(score)(parameters, buffers)
    looped = torch.stack([channel(given).log_prob(outcome) for channel in channels])
    torch.testing.assert_close(stacked, looped, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", INSTANCES)
def test_state_dict_round_trip(name):
    channel, other = make_typical(name), make(name, seed=1)
    file = io.BytesIO()
    torch.save(channel.state_dict(), file)
    file.seek(0)
    other.load_state_dict(torch.load(file, weights_only=True))
    given = conditions(channel, (5,))
    outcome = channel(given).sample()
    assert torch.equal(channel(given).log_prob(outcome), other(given).log_prob(outcome))


@pytest.mark.parametrize("name", INSTANCES)
def test_forward_is_deterministic(name):
    channel = make_typical(name)
    given = conditions(channel, (5,))
    before = torch.get_rng_state()
    first, second = channel(given), channel(given)
    assert torch.equal(before, torch.get_rng_state())
    outcome = first.sample()
    assert torch.equal(first.log_prob(outcome), second.log_prob(outcome))
