"""The categorical distribution is torch's, to full precision whichever way it is given."""

import pytest
import torch
from torch import distributions

from bra.channels.distributions import Categorical

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
