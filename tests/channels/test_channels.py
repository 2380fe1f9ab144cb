"""What each channel is, and how it starts."""

import math
from itertools import pairwise

import pytest
import torch
from channel_kinds import INSTANCES, image, make, pair, real
from gymnasium.spaces import Discrete
from torch import nn

from bra.channels import CNN, MLP, Gaussian, Multinomial, Table
from bra.channels.covering import covering_logits


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
