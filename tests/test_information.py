import math

import pytest
import torch

from bra.information import entropy, kl_divergence, mutual_information

DOUBLE = torch.float64


def simplex(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(*shape, generator=generator, dtype=DOUBLE).log().mul(-1).softmax(-1)


@pytest.mark.parametrize(
    ("probabilities", "nats"),
    [
        ([1.0], 0.0),
        ([0.5, 0.5], math.log(2)),
        ([1.0, 0.0, 0.0], 0.0),
        ([0.25] * 4, math.log(4)),
        ([0.5, 0.25, 0.25, 0.0], 1.5 * math.log(2)),
    ],
)
def test_entropy_of_known_distributions(probabilities, nats):
    assert entropy(torch.tensor(probabilities, dtype=DOUBLE)).item() == pytest.approx(
        nats, abs=1e-15
    )


@pytest.mark.parametrize(
    ("p", "q", "nats"),
    [
        ([0.5, 0.5], [0.5, 0.5], 0.0),
        ([1.0, 0.0], [0.5, 0.5], math.log(2)),
        ([0.5, 0.5, 0.0], [0.25, 0.75, 0.0], 0.5 * math.log(2) + 0.5 * math.log(2 / 3)),
        ([0.5, 0.5], [1.0, 0.0], math.inf),
    ],
)
def test_kl_divergence_of_known_distributions(p, q, nats):
    result = kl_divergence(torch.tensor(p, dtype=DOUBLE), torch.tensor(q, dtype=DOUBLE))
    assert result.item() == pytest.approx(nats, abs=1e-15)


def test_mutual_information_of_the_binary_symmetric_channel():
    error = 0.11
    channel = torch.tensor([[1 - error, error], [error, 1 - error]], dtype=DOUBLE)
    half = torch.tensor([0.5, 0.5], dtype=DOUBLE)
    binary_entropy = -error * math.log(error) - (1 - error) * math.log(1 - error)
    expected = math.log(2) - binary_entropy
    assert mutual_information(half, channel).item() == pytest.approx(expected, abs=1e-15)


def test_mutual_information_is_an_entropy_difference():
    prior, conditional = simplex(3, 5), simplex(3, 5, 7, seed=1)
    marginal = (prior[..., None] * conditional).sum(-2)
    expected = entropy(marginal) - (prior * entropy(conditional)).sum(-1)
    torch.testing.assert_close(mutual_information(prior, conditional), expected)


def test_mutual_information_survives_near_independence():
    # r = 1e-7 off independence: I = r²/2 to leading order, far below the rounding of the entropies.
    r = 1e-7
    conditional = torch.tensor(
        [[0.5 + r / 2, 0.5 - r / 2], [0.5 - r / 2, 0.5 + r / 2]], dtype=DOUBLE
    )
    half = torch.tensor([0.5, 0.5], dtype=DOUBLE)
    assert mutual_information(half, conditional).item() == pytest.approx(r * r / 2, rel=1e-6)


def test_condition_without_mass_contributes_nothing():
    conditional = torch.tensor([[1.0, 0.0], [0.0, 1.0]], dtype=DOUBLE)
    assert mutual_information(torch.tensor([1.0, 0.0], dtype=DOUBLE), conditional).item() == 0.0


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_batch_dimensions_lead(batch):
    p, q, conditional = simplex(*batch, 5), simplex(5, seed=1), simplex(*batch, 5, 6, seed=2)
    assert entropy(p).shape == batch
    assert kl_divergence(p, q).shape == batch
    assert mutual_information(p, conditional).shape == batch
    assert mutual_information(q, conditional).shape == batch


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dtype_is_kept(dtype):
    p, conditional = simplex(5).to(dtype), simplex(5, 6).to(dtype)
    assert entropy(p).dtype == dtype
    assert kl_divergence(p, p.flip(0)).dtype == dtype
    assert mutual_information(p, conditional).dtype == dtype


@pytest.mark.parametrize("function", [entropy, lambda p: kl_divergence(p, p.roll(1, -1))])
def test_gradients_match_finite_differences(function):
    assert torch.autograd.gradcheck(function, simplex(2, 5).requires_grad_())


def test_gradients_of_mutual_information_match_finite_differences():
    inputs = simplex(4).requires_grad_(), simplex(4, 3).requires_grad_()
    assert torch.autograd.gradcheck(mutual_information, inputs)


def test_gradients_are_finite_at_zeros():
    p = torch.tensor([1.0, 0.0, 0.0], dtype=DOUBLE, requires_grad=True)
    q = torch.tensor([0.5, 0.5, 0.0], dtype=DOUBLE, requires_grad=True)
    conditional = torch.eye(3, dtype=DOUBLE).requires_grad_()
    total = entropy(p) + kl_divergence(p, q) + mutual_information(p, conditional)
    for gradient in torch.autograd.grad(total, (p, q, conditional)):
        assert gradient.isfinite().all()


def test_gradient_reaches_logits_through_a_saturated_softmax():
    logits = torch.tensor([[800.0, 0.0], [0.0, 1.0]], dtype=DOUBLE, requires_grad=True)
    prior = torch.tensor([0.5, 0.5], dtype=DOUBLE)
    mutual_information(prior, logits.softmax(-1)).backward()
    assert logits.grad.isfinite().all()
    assert logits.grad[1].abs().sum() > 0
