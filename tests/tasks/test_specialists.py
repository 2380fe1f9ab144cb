"""The tasks in which percepts choose specialists."""

import pytest
import torch

from bra.tasks import Medical, Taxonomy


def test_medical_table():
    task = Medical()
    assert task.utilities.shape == (6, 10)
    table = {
        (state, action): task.utilities[i, j].item()
        for i, state in enumerate(task.state_names)
        for j, action in enumerate(task.action_names)
    }
    assert table["h1", "h1"] == 3
    assert table["h2", "h1"] == 0.9
    assert table["l3", "l4"] == table["l1", "l"] == table["h1", "h"] == 1.5
    assert table["l2", "l12"] == table["l4", "l34"] == 2.5
    assert table["l2", "l34"] == table["h1", "l"] == table["l1", "h1"] == 0
    assert torch.equal(task.prior, torch.full((6,), 1 / 6, dtype=torch.float64))


def test_medical_heart_heavy_prior():
    prior = Medical("heart-heavy").prior
    torch.testing.assert_close(prior[0] / prior[2], torch.tensor(3.0).double())
    assert prior[0] == prior[1]
    with pytest.raises(ValueError, match="must be uniform or heart-heavy, got 'lungs'"):
        Medical("lungs")


def test_taxonomy_table():
    utilities = Taxonomy().utilities
    assert utilities.shape == (13, 19)
    sums = utilities.sum(1)
    expected = torch.full((13,), 6.8).double()
    expected[9], expected[12] = 6.8 + 2.2, 3 + 3 + 2.2 + 1.6
    torch.testing.assert_close(sums, expected)
    assert utilities[12, [11, 12, 16, 18]].tolist() == [3, 3, 2.2, 1.6]
    assert utilities[9, 15] == utilities[9, 16] == 2.2
    assert utilities[5, 17] == utilities[6, 18] == 1.6
