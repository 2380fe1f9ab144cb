"""The categorical distribution is torch's, to full precision whichever way it is given."""

import pytest
import torch
from torch import distributions

from bra.channels.distributions import FEW, Categorical, log_normalise, normalise

LOGITS = torch.randn(3, 4, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("rows", [LOGITS, LOGITS[0]], ids=["batch", "one"])
@pytest.mark.parametrize("given", ["logits", "probs"])
def test_categorical_is_that_of_torch(rows, given):
    argument = {given: rows.softmax(-1) if given == "probs" else rows}
    ours, theirs = Categorical(**argument), distributions.Categorical(**argument)
    torch.testing.assert_close(ours.probs, theirs.probs)
    torch.testing.assert_close(ours.logits, theirs.logits)
    torch.testing.assert_close(ours.entropy(), theirs.entropy())
    values = torch.tensor([[1], [3]])
    torch.testing.assert_close(ours.log_prob(values), theirs.log_prob(values))
    wide = ours.expand((5, *ours.batch_shape))
    assert isinstance(wide, Categorical) and wide.batch_shape == (5, *ours.batch_shape)
    expected = theirs.expand((5, *theirs.batch_shape)).log_prob(values[0])
    torch.testing.assert_close(wide.log_prob(values[0]), expected)
    torch.manual_seed(0)
    drawn = ours.sample((7,))
    torch.manual_seed(0)
    assert torch.equal(drawn, theirs.sample((7,)))
    assert ours.support.upper_bound == 3 and len(ours.enumerate_support()) == 4


def test_small_probabilities_are_scored_as_they_are():
    assert Categorical(torch.tensor([1.0, 1e-30])).log_prob(torch.tensor(1)).exp() > 0.9e-30
    with pytest.raises(ValueError, match="either probs or logits"):
        Categorical()


@pytest.mark.parametrize("given", ["logits", "probs"])
@pytest.mark.parametrize("looked", [True, False])
def test_in_float64_it_is_what_was_given_normalised_there(given, looked):
    rows = LOGITS.softmax(-1) if given == "probs" else LOGITS
    ours = Categorical(**{given: rows})
    if looked:
        assert ours.logits.dtype == ours.probs.dtype == torch.float32
    exact = rows.double() if given == "probs" else rows.double().softmax(-1)
    for found in (ours, ours.expand((2, 3))):
        assert found.double().probs.dtype == torch.double
    torch.testing.assert_close(ours.double().probs, exact, rtol=1e-13, atol=0)
    torch.testing.assert_close(ours.expand((2, 3)).double().probs[1], exact)


@pytest.mark.parametrize("rows", [3, 2 * FEW])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_few_and_many_logits_are_normalised_alike_and_so_are_their_gradients(rows, scale):
    generator = torch.Generator().manual_seed(rows)
    logits, weights = torch.randn(2, rows, 5, dtype=torch.double, generator=generator)
    logits = (scale * logits).requires_grad_()
    expected = logits.log_softmax(-1)
    for function in (log_normalise, torch.vmap(log_normalise)):
        torch.testing.assert_close(function(logits), expected, rtol=1e-13, atol=1e-12)
        logits.grad = None
        (weights * function(logits)).sum().backward()
        p = expected.exp().detach()
        slope = weights - p * weights.sum(-1, keepdim=True)
        torch.testing.assert_close(logits.grad, slope, rtol=1e-10, atol=1e-11)
    for function in (normalise, torch.vmap(normalise)):
        torch.testing.assert_close(function(logits), expected.exp(), rtol=1e-10, atol=1e-12)
