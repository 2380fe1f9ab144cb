"""Known states behind a noisy sensor: trained, evaluated and logged."""

import json
from functools import partial
from types import SimpleNamespace

import lightning.pytorch as pl
import pytest
import torch
from gymnasium.spaces import Discrete

from bra import Population
from bra.agent.agent import Agent
from bra.callbacks import BaselineMonitor, BehaviourFigures, InformationMonitor, RunSummary
from bra.callbacks.hits import hits
from bra.channels import MLP, Multinomial, Table
from bra.marginals import ExactMarginals, RunningMarginals
from bra.tasks import FiniteTask, RolloutDataModule
from bra.update_rules import ExactGradient, ScoreFunction


class Tones(FiniteTask):
    """Two states; each shows one of its own two signals, or, now and then, one of the other's."""

    def __init__(self) -> None:
        super().__init__([[1.0, 0.0], [0.0, 1.0]], observations=Discrete(4))

    def observe(self, state, generator):
        tone = torch.randint(2, state.shape, generator=generator)
        slip = torch.rand(state.shape, generator=generator) < 0.1
        return 2 * (state ^ slip.long()) + tone


def agent(**arguments):
    return Agent(
        Tones(),
        perception=Table,
        action=Multinomial,
        percepts=2,
        beta_perception=8.0,
        beta_action=8.0,
        update_rule=ScoreFunction(samples=4, baseline="leave-one-out"),
        perception_optimizer=partial(torch.optim.Adam, lr=0.1),
        action_optimizer=partial(torch.optim.Adam, lr=0.1),
        seed=1,
        **arguments,
    )


def test_no_table_of_signals():
    task = Tones()
    assert not task.noiseless and task.observations is None
    with pytest.raises(ValueError, match="Tones has a noisy sensor and no table of signals"):
        task.states()
    world = task.sample(1000, torch.Generator().manual_seed(0))
    # 1000 draws of probability 0.1: six standard errors, failure probability 2e-9.
    assert ((world.observation // 2) != world.state).double().mean() == pytest.approx(0.1, abs=0.06)


def test_exact_parts_refuse():
    with pytest.raises(ValueError, match="ExactMarginals need a noiseless sensor"):
        agent(marginals=ExactMarginals())
    with pytest.raises(ValueError, match=r"ExactGradient needs a noiseless sensor.*ScoreFunction"):
        Agent(Tones(), Table, Multinomial, update_rule=ExactGradient())


def test_held_back_signals_stay_the_same_and_leave_training_alone():
    one = agent()
    assert isinstance(one.marginals, RunningMarginals)
    state = torch.get_rng_state()
    first = one.evaluate()
    one.updates = 7
    assert one.evaluate() == first
    assert torch.equal(torch.get_rng_state(), state)
    assert one.behaviour().shape == (2, 2)
    torch.testing.assert_close(one.behaviour().sum(-1), torch.ones(2).double())


def test_each_member_of_a_population_is_judged_by_its_own_error():
    rule = ScoreFunction(samples=4, baseline="leave-one-out")
    many = Population(Tones(), 3, perception=MLP, action=MLP, percepts=2, update_rule=rule, seed=5)
    found = many.evaluate_members()
    members = [many.member(i).evaluation() for i in range(3)]
    for term, values in found.known().items():
        own = torch.tensor([getattr(member.objective, term) for member in members])
        torch.testing.assert_close(values, own.double(), rtol=1e-6, atol=1e-9)
    said = [member.standard_error.objective for member in members]
    assert found.standard_error.tolist() == pytest.approx(said)
    # An optimum that lies between what is allowed to two of them parts hits from misses.
    least, most = (i(found.objective + 2 * found.standard_error).item() for i in (min, max))
    optimum = (least + most) / 2 + 0.005
    baseline = BaselineMonitor()
    prices = many.settings[0].prices
    baseline.references = {prices: SimpleNamespace(objective=optimum, error=0.0)}
    expected = found.objective + 2 * found.standard_error + 0.005 >= optimum
    assert hits(many, baseline).tolist() == expected.tolist()
    assert 0 < expected.sum() < 3


def test_learns_and_logs_what_the_sensor_hides(tmp_path):
    one = agent()
    monitors = [InformationMonitor(), BaselineMonitor(), BehaviourFigures(), RunSummary()]
    trainer = pl.Trainer(
        default_root_dir=tmp_path,
        max_epochs=1,
        callbacks=monitors,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    trainer.fit(one, RolloutDataModule(one.task, batch_size=64, updates_per_epoch=220))
    (path,) = tmp_path.rglob("summary.json")
    summary = json.loads(path.read_text())
    # One signal in ten deceives: E[U] ≤ 0.9, I(Ω;X) ≤ ln 2 − h(0.1) = 0.368 nats.
    assert 0.85 < summary["expected_utility"] < 0.93
    assert 0.25 < summary["state_information_nats"] < 0.42
    assert summary["perception_information_nats"] > summary["state_information_nats"] + 0.1
    assert summary["end_to_end_information_nats"] <= summary["state_information_nats"] + 1e-6
    assert summary["objective"] < summary["objective_without_sensor_noise"]
    assert (
        0 <= summary["objective_without_sensor_noise"] - summary["blahut_arimoto_objective"] < 0.2
    )
    assert 0.005 < summary["objective_standard_error"] < 0.03
    assert 0.005 < summary["expected_utility_standard_error"] < 0.015  # √(0.9 · 0.1 / 1024)
    assert summary["gap"] == pytest.approx(0, abs=0.06)
