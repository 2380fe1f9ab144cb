"""What people may set of channels, rules, critics, tasks and monitors."""

from functools import partial

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete

from bra import Agent, PredatorPrey, TableTask
from bra.callbacks import BaselineMonitor
from bra.channels import MLP, Gaussian, Multinomial, Table
from bra.critics import Exploration, NetworkCritic, TableCritic
from bra.marginals import RunningMarginals
from bra.population import Population
from bra.tasks import FiniteTask
from bra.tasks.nao_mugs import NaoMugs
from bra.update_rules import Projection

SPACES = (Discrete(2), Discrete(3))
NUMBERS = (Box(-1, 1, (2,)), Discrete(3))
TWO = np.eye(2)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (partial(MLP, *NUMBERS, output_gain=1e308), "output_gain must be between .* got 1e.308"),
        (partial(MLP, *NUMBERS, input_gain="abc"), "input_gain must be positive .* got 'abc'"),
        (partial(MLP, *NUMBERS, covering_logit=np.nan), "covering_logit must be finite"),
        (partial(MLP, *NUMBERS, bias="no"), "bias must be true or false, got 'no'"),
        (partial(MLP, *NUMBERS, hidden=3.5), "hidden sizes must be a list of whole .* got 3.5"),
        (partial(MLP, *NUMBERS, hidden="20"), "hidden sizes must be a list of whole .* got '20'"),
        (partial(MLP, *NUMBERS, hidden=[2.5]), r"hidden sizes must be at least 1, got \[2.5\]"),
        (partial(Table, *SPACES, spread=1e30), "spread must be between .* got 1e.30"),
        (partial(Table, *SPACES, spread=True), "spread must be finite .* got True"),
        (partial(Table, *SPACES, covering_logit=[]), r"covering_logit must be .* got \[\]"),
        (partial(Gaussian, Discrete(2), Box(0, 1, (2,)), scale=1e39), "scale must be between"),
        (partial(Multinomial, *SPACES, reference=0.5), "reference must be an outcome, .* got 0.5"),
        (partial(Multinomial, *SPACES, start={}), "start must be covering, or finite .* got {}"),
        (partial(NetworkCritic, start=1e308), "start must be between .* got 1e.308"),
        (partial(NetworkCritic, lr=1j), "lr must be positive and finite, got 1j"),
        (partial(NetworkCritic, memory=10**13), "memory 10,000,000,000,000 would take more than"),
        (partial(TableCritic, None), "start must be finite, got None"),
        (partial(Exploration, "all"), "exploration share must be between 0 and 1, got 'all'"),
        (partial(RunningMarginals, 1j), "decay must be at least 0 and less than 1, got 1j"),
        (partial(Projection, "much"), "decay must be at least 0 and less than 1, got 'much'"),
        (partial(BaselineMonitor, certify=-1), "certify must be a positive number of seconds"),
        (partial(Population, PredatorPrey(), grid=[0]), r"grid must be true or false, got \[0\]"),
        (partial(NaoMugs, bank=0.5), "bank must be a whole number of at least 0, got 0.5"),
        (partial(NaoMugs, contrast="high"), "contrast must be true or false, got 'high'"),
        (partial(NaoMugs, pixel_noise="much"), "pixel_noise must be at least 0, got 'much'"),
        (partial(TableTask, TWO, state_names=0), "must be a list of text, got 0"),
        (partial(TableTask, TWO, action_names=torch.tensor(2)), "must be a list of text, got ten"),
        (partial(TableTask, TWO, state_names=[]), "expected 2 names for s0, s1"),
        (partial(FiniteTask, TWO, state_numbers=[0, 1.5]), r"2 whole state numbers .* \[0, 1.5\]"),
        (partial(FiniteTask, TWO, state_numbers=3), "expected 2 whole state numbers .* got 3"),
    ],
)
def test_settings_that_are_none(make, said):
    with pytest.raises(ValueError, match=said) as caught:
        make()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("part", ["critic", "exploration", "rivals"])
@pytest.mark.parametrize("value", ["Rivals", 0, [], TableCritic])
def test_parts_of_a_rule_are_of_their_kind(part, value):
    with pytest.raises(TypeError, match=f"{part} must be "):
        Projection(**{part: value})


@pytest.mark.parametrize("value", [0, [], {}])
def test_nothing_is_none_of_the_marginals(value):
    with pytest.raises(TypeError, match="marginals must be of class Marginals"):
        Agent(PredatorPrey(), marginals=value)


def test_numbers_of_numpy_are_numbers():
    channel = MLP(*NUMBERS, hidden=np.array([4, 3]), input_gain=np.float32(2), bias=np.bool_(False))
    assert [layer.bias for layer in channel.network if hasattr(layer, "bias")] == [None] * 3
    assert Multinomial(*SPACES, reference=np.int64(1)).reference == 1
    assert FiniteTask(TWO, state_numbers=np.array([5, 9]), observations="binary").prior.shape == (
        2,
    )
