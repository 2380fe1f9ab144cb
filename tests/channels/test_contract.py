"""What every channel owes, checked on one table of instances."""

import io
import math
from itertools import pairwise, product

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete, Tuple
from torch import nn
from torch.distributions import Categorical
from torch.func import functional_call, stack_module_state, vmap

from bra.channels import CNN, MLP, Channel, Gaussian, Multinomial, Table
from bra.channels.base import check_channel
from bra.channels.covering import covering_logits
from bra.channels.distributions import probabilities

BATCH_SHAPES = [(), (5,), (2, 3)]


class Noisy(Channel):
    """The example in Channel's docstring."""

    def __init__(self, condition_space, outcome_space, width=32):
        super().__init__(condition_space, outcome_space)
        self.net = nn.Sequential(
            nn.LazyLinear(width), nn.ReLU(), nn.Linear(width, int(outcome_space.n))
        )

    def forward(self, condition):
        return Categorical(logits=self.net(condition))


class Gated(Channel):
    """A channel of one's own with two conditions: a specialist for each percept."""

    condition_spaces = (Tuple,)

    def __init__(self, condition_space, outcome_space):
        super().__init__(condition_space, outcome_space)
        percepts, signals = condition_space
        self.weight = nn.Parameter(
            torch.randn(int(percepts.n), signals.shape[0], int(outcome_space.n))
        )

    def forward(self, condition):
        percept, signal = condition
        return Categorical(logits=(signal.unsqueeze(-2) @ self.weight[percept]).squeeze(-2))


def real(*shape):
    return Box(-np.inf, np.inf, shape=shape, dtype=np.float32)


def image(*shape):
    return Box(0, 255, shape=shape, dtype=np.uint8)


def pair(percepts, observation):
    return Tuple((Discrete(percepts), observation))


# name: class, own arguments, condition space, outcome space
INSTANCES = {
    "mlp index to index": (MLP, {}, Discrete(3), Discrete(4)),
    "mlp of the paper": (MLP, {"hidden": [20], "bias": False}, real(4), Discrete(13)),
    "mlp deep, relu": (MLP, {"hidden": [8, 8], "activation": nn.ReLU}, real(2, 3), Discrete(3)),
    "mlp linear": (MLP, {"hidden": []}, real(3), Discrete(2)),
    "mlp linear table": (MLP, {"hidden": [], "bias": False}, Discrete(4), Discrete(5)),
    "mlp scalar to index": (MLP, {"activation": nn.SiLU}, real(), Discrete(3)),
    "mlp 8-bit": (MLP, {"activation": nn.Sigmoid}, image(1, 2, 2), Discrete(3)),
    "mlp index to number": (MLP, {"hidden": [6]}, Discrete(4), real(1)),
    "mlp index to scalar": (MLP, {"hidden": []}, Discrete(4), real()),
    "mlp box to box": (MLP, {"activation": nn.GELU, "bias": False}, real(3), real(2)),
    "mlp box to matrix": (MLP, {"hidden": [5, 4]}, real(2, 2), real(2, 3)),
    "cnn": (CNN, {}, real(1, 3, 3), Discrete(3)),
    "cnn 8-bit, oblong": (CNN, {"channels": [4]}, image(3, 6, 5), Discrete(2)),
    "cnn 1 × 1": (CNN, {"channels": [4, 4, 4]}, real(2, 1, 1), Discrete(4)),
    "cnn to box": (CNN, {"channels": [4, 8]}, real(1, 4, 4), real(2)),
    "table": (Table, {}, Discrete(5), Discrete(3)),
    "table, one outcome": (Table, {"spread": 0.0}, Discrete(2), Discrete(1)),
    "multinomial": (Multinomial, {}, Discrete(4), Discrete(5)),
    "multinomial, reference in the middle": (
        Multinomial,
        {"reference": 1, "start": [[1.0, -2.0], [0.5, 3.0]]},
        Discrete(2),
        Discrete(3),
    ),
    "multinomial, covering": (Multinomial, {"start": "covering"}, Discrete(4), Discrete(3)),
    "table, covering": (Table, {"start": "covering"}, Discrete(3), Discrete(4)),
    "multinomial, reference last": (Multinomial, {"reference": 2}, Discrete(4), Discrete(3)),
    "gaussian": (Gaussian, {}, Discrete(4), real(1)),
    "gaussian, narrow": (Gaussian, {"scale": 0.05}, Discrete(3), real(2, 3)),
    "gaussian, scalar": (Gaussian, {"scale": 2.0}, Discrete(3), real()),
    "custom": (Noisy, {"width": 7}, real(4), Discrete(3)),
    "table of pairs": (Table, {"start": "covering"}, pair(3, Discrete(4)), Discrete(5)),
    "multinomial of pairs": (Multinomial, {"reference": 1}, pair(3, Discrete(2)), Discrete(4)),
    "gaussian of pairs": (Gaussian, {}, pair(2, Discrete(3)), real(1)),
    "mlp of pairs": (MLP, {"hidden": [5]}, pair(3, real(2, 2)), Discrete(4)),
    "mlp of pairs to box": (MLP, {"hidden": [5]}, pair(3, Discrete(2)), real(1)),
    "mlp of pairs, covering": (MLP, {"start": "covering"}, pair(3, real(2)), Discrete(4)),
    "cnn of pairs": (CNN, {"channels": [4]}, pair(3, image(1, 3, 4)), Discrete(4)),
    "cnn of pairs to box": (CNN, {"channels": [2]}, pair(2, real(1, 3, 3)), real(2)),
    "custom, of pairs": (Gated, {}, pair(3, real(4)), Discrete(3)),
}
# One outcome leaves nothing to learn.
LEARNABLE = [name for name in INSTANCES if name != "table, one outcome"]


def make(name, seed=0):
    cls, arguments, condition_space, outcome_space = INSTANCES[name]
    torch.manual_seed(seed)
    return cls(condition_space, outcome_space, **arguments)


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


@pytest.mark.parametrize("name", [name for name in INSTANCES if name != "custom"])
def test_the_start_is_a_function_of_the_seed(name):
    one, same = make(name).state_dict(), make(name).state_dict()
    assert all(torch.equal(one[key], same[key]) for key in one)


def test_mlp_is_the_network_of_the_paper():
    torch.manual_seed(0)
    channel = MLP(real(4), Discrete(13), hidden=[20], bias=False)
    v, w = (weight.detach().T for weight in channel.parameters())
    assert (v.shape, w.shape) == ((4, 20), (20, 13))
    signals = torch.tensor([[0.0, 1, 0, 1], [1, 1, 0, 0], [0, 0, 0, 0]])
    expected = torch.softmax(torch.tanh(signals @ v) @ w, -1)
    torch.testing.assert_close(channel(signals).probs, expected)
    torch.testing.assert_close(expected[2], torch.full((13,), 1 / 13))


def test_xavier_bounds():
    torch.manual_seed(0)
    channel = MLP(real(4), Discrete(13), hidden=[20, 10])
    linear = [layer for layer in channel.network if isinstance(layer, nn.Linear)]
    for layer, (inputs, outputs) in zip(linear, pairwise([4, 20, 10, 13]), strict=True):
        bound = math.sqrt(6 / (inputs + outputs))
        largest = layer.weight.abs().max().item()
        # At least 80 weights uniform on ±bound: all within 90 % of it has probability 0.9⁸⁰ =
        # 2e-4 per layer.
        assert 0.9 * bound < largest <= bound
        assert torch.equal(layer.bias, torch.zeros(outputs))


def test_gains_scale_the_first_and_the_last_layer():
    def weights(cls, space, **own):
        torch.manual_seed(0)
        return [p.detach() for p in cls(space, Discrete(5), **own).parameters() if p.ndim > 1]

    plain = weights(MLP, real(4), hidden=[6, 7])
    scaled = weights(MLP, real(4), hidden=[6, 7], input_gain=5.0, output_gain=3.0)
    for one, other, gain in zip(plain, scaled, (5, 1, 3), strict=True):
        torch.testing.assert_close(other, gain * one)
    (linear,) = weights(MLP, real(4), hidden=[], input_gain=5.0, output_gain=3.0)
    torch.testing.assert_close(linear, 15 * weights(MLP, real(4), hidden=[])[0])
    plain = weights(CNN, real(1, 3, 3))
    scaled = weights(CNN, real(1, 3, 3), output_gain=3.0)
    for one, other, gain in zip(plain, scaled, (1, 1, 3), strict=True):
        torch.testing.assert_close(other, gain * one)


@pytest.mark.parametrize(
    ("condition_space", "condition", "vector"),
    [
        (Discrete(3), torch.tensor([2, 0]), [[0.0, 0, 1], [1, 0, 0]]),
        (real(1, 2), torch.tensor([[[3.0, -4]]]), [[3.0, -4]]),
        (image(2, 1), torch.tensor([[[255], [51]]], dtype=torch.uint8), [[1.0, 0.2]]),
    ],
)
def test_what_the_network_sees(condition_space, condition, vector):
    channel = MLP(condition_space, Discrete(2), hidden=[])
    (layer,) = channel.network
    expected = torch.log_softmax(layer(torch.tensor(vector)), -1)
    torch.testing.assert_close(channel(condition).logits, expected)


@pytest.mark.parametrize("reference", [0, 1, 3])
def test_multinomial_is_the_exponential_family_of_the_paper(reference):
    generator = torch.Generator().manual_seed(0)
    eta = 2 * torch.randn(3, 2, generator=generator)
    channel = Multinomial(Discrete(2), Discrete(4), reference=reference, start=eta)
    others = [action for action in range(4) if action != reference]
    for x in range(2):
        psi = math.log(1 + sum(math.exp(eta[i, x]) for i in range(3)))
        for action in range(4):
            onehot = [float(action == other) for other in others]
            exponent = sum(eta[i, x].item() * onehot[i] for i in range(3)) - psi
            probability = channel(torch.tensor(x)).probs[action].item()
            assert probability == pytest.approx(math.exp(exponent), rel=1e-5)


@pytest.mark.parametrize("reference", [0, 2])
def test_multinomial_starts_uniform(reference):
    channel = Multinomial(Discrete(3), Discrete(4), reference=reference)
    assert channel.eta.shape == (3, 3)
    assert torch.equal(channel(torch.arange(3)).probs, torch.full((3, 4), 0.25))


@pytest.mark.parametrize(("percepts", "actions"), [(13, 9), (4, 4), (3, 7), (1, 2), (5, 1)])
@pytest.mark.parametrize("reference", [0, -1])
def test_a_covering_start_shares_out_the_actions(percepts, actions, reference):
    torch.manual_seed(0)
    own = {"start": "covering", "reference": reference % actions, "covering_logit": 2.0}
    channel = Multinomial(Discrete(percepts), Discrete(actions), **own)
    p = channel(torch.arange(percepts)).probs
    torch.manual_seed(0)
    logits = covering_logits(percepts, actions, 2.0)
    torch.testing.assert_close(p, logits.softmax(1))
    favoured = logits == 2
    assert torch.equal(logits, 2.0 * favoured)
    for shares in (favoured.sum(0), favoured.sum(1)):
        assert shares.min() >= 1 and shares.max() - shares.min() <= 1


@pytest.mark.parametrize("cls", [MLP, CNN])
def test_percepts_share_out_the_actions_of_a_network(cls):
    torch.manual_seed(0)
    channel = cls(pair(4, real(1, 3, 3)), Discrete(4), start="covering", covering_logit=9.0)
    percept = torch.arange(4).expand(5, 4)
    p = channel((percept, torch.rand(5, 4, 1, 3, 3))).probs
    favourite = p.argmax(-1)
    assert (favourite == favourite[0]).all()
    assert sorted(favourite[0].tolist()) == [0, 1, 2, 3]
    assert p.amax(-1).min() > 0.99


@pytest.mark.parametrize(
    ("condition", "outcome", "message"),
    [
        (pair(2, real(3)), real(1), "shares out Discrete outcomes, got Box"),
        (real(3), Discrete(2), "needs a Tuple of Discrete percepts and signals, got Box"),
    ],
)
def test_what_no_covering_start_can_share_out(condition, outcome, message):
    with pytest.raises(ValueError, match=message):
        MLP(condition, outcome, start="covering")


def test_covering_starts_are_random_and_the_same_for_table_and_multinomial():
    def favourites(cls, seed, **own):
        torch.manual_seed(seed)
        channel = cls(Discrete(6), Discrete(6), start="covering", **own)
        return channel(torch.arange(6)).probs.argmax(1).tolist()

    assert favourites(Multinomial, 0) == favourites(Multinomial, 0)
    assert favourites(Multinomial, 0) != favourites(Multinomial, 1)
    assert sorted(favourites(Table, 0, spread=0.1)) == list(range(6))


def test_multinomial_keeps_its_own_start():
    start = torch.zeros(1, 2)
    channel = Multinomial(Discrete(2), Discrete(2), start=start)
    with torch.no_grad():
        channel.eta.add_(1)
    assert torch.equal(start, torch.zeros(1, 2))


def test_gaussian_by_hand():
    channel = Gaussian(Discrete(2), real(2), scale=0.3)
    torch.testing.assert_close(channel(torch.tensor([0, 1])).stddev, torch.full((2, 2), 0.3))
    with torch.no_grad():
        channel.mean.copy_(torch.tensor([[0.0, 1], [2, 3]]))
        channel.log_scale.copy_(torch.tensor([[0.0, 0], [0, math.log(2)]]))
    outcome = torch.tensor([2.5, 1.0])
    expected = sum(
        -0.5 * ((y - mean) / scale) ** 2 - math.log(scale) - 0.5 * math.log(2 * math.pi)
        for y, mean, scale in ((2.5, 2, 1.001), (1.0, 3, 2.001))
    )
    assert channel(torch.tensor(1)).log_prob(outcome).item() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("make_channel", [Gaussian, MLP])
def test_scales_are_bounded_below(make_channel):
    channel = make_channel(Discrete(2), real(1))
    with torch.no_grad():
        if isinstance(channel, Gaussian):
            channel.log_scale.fill_(-1e4)
        else:
            channel.network[-1].bias.copy_(torch.tensor([0.0, -1e4]))  # mean, log-scale
    distribution = channel(torch.tensor([0, 1]))
    torch.testing.assert_close(distribution.stddev, torch.full((2, 1), 1e-3))
    assert distribution.log_prob(distribution.sample()).isfinite().all()


def test_table_is_a_softmax_per_condition():
    torch.manual_seed(0)
    channel = Table(Discrete(2), Discrete(3))
    torch.testing.assert_close(channel(torch.tensor(1)).probs, channel.logits[1].softmax(-1))
    uniform = Table(Discrete(2), Discrete(4), spread=0.0)(torch.arange(2)).probs
    assert torch.equal(uniform, torch.full((2, 4), 0.25))
