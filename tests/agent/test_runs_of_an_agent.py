"""What an agent keeps from update to update and from run to run."""

import math
import os
from contextlib import nullcontext
from functools import partial
from types import SimpleNamespace

import lightning.pytorch as pl
import pytest
import torch
from gymnasium.spaces import Box, Discrete
from lightning.pytorch.callbacks import ModelCheckpoint
from small_agents import make_agent
from training import assert_same_state, fit, make_trainer

from bra import Agent, PredatorPrey, RolloutDataModule, TableTask
from bra.channels import MLP, Gaussian, Multinomial, Table
from bra.marginals import BatchMarginals, RunningMarginals
from bra.tasks import TargetTask
from bra.update_rules import ExactGradient, ScoreFunction


def test_max_steps_counts_updates(tmp_path):
    agent = make_agent()
    fit(agent, tmp_path, max_epochs=-1, max_steps=17)
    assert agent.updates == 17


def test_checkpoints_appear_when_asked_for(tmp_path):
    callback = ModelCheckpoint(tmp_path, "{step}", every_n_train_steps=7, save_top_k=-1)
    fit(make_agent(), tmp_path, max_epochs=3, callbacks=[callback], enable_checkpointing=True)
    assert sorted(path.name for path in tmp_path.glob("*.ckpt")) == [
        "step=14.ckpt",
        "step=21.ckpt",
        "step=28.ckpt",
        "step=7.ckpt",
    ]


@pytest.mark.parametrize(
    ("cut", "workers"),
    [(13, 0), (10, 0), (13, 2)],
    ids=["within an epoch", "between epochs", "with two workers"],
)
def test_a_resumed_run_ends_where_the_uninterrupted_one_does(tmp_path, cut, workers):
    through = make_agent()
    fit(through, tmp_path, max_epochs=3)

    callback = ModelCheckpoint(tmp_path, "cut", every_n_train_steps=cut)
    cut_run = {"callbacks": [callback], "enable_checkpointing": True, "max_steps": cut}
    fit(make_agent(), tmp_path, workers, max_epochs=3, **cut_run)
    torch.manual_seed(99)  # a new process knows nothing of the old one's generators
    resumed = make_agent(seed=4)
    fit(resumed, tmp_path, workers, ckpt_path=tmp_path / "cut.ckpt", max_epochs=3)

    assert resumed.updates == 30
    assert resumed.seed == 3
    assert_same_state(resumed, through)


def test_a_run_stopped_within_an_epoch_resumes_from_the_checkpoint_it_leaves(tmp_path):
    through = make_agent()
    fit(through, tmp_path, max_epochs=3)
    callback = ModelCheckpoint(tmp_path, save_last=True)  # at the end of an epoch, and of the run
    stopped = {"callbacks": [callback], "enable_checkpointing": True, "max_steps": 17}
    fit(make_agent(), tmp_path, max_epochs=3, **stopped)
    resumed = make_agent()
    fit(resumed, tmp_path, ckpt_path=tmp_path / "last.ckpt", max_epochs=3)
    assert resumed.updates == 30
    assert_same_state(resumed, through)


def test_epochs_may_start_anywhere(tmp_path):
    agent = make_agent()
    fit(agent, tmp_path, max_epochs=3, limit_train_batches=7)
    assert agent.updates == 21
    fit(agent, tmp_path, max_epochs=2)
    assert agent.updates == 41


def test_watching_does_not_change_training(tmp_path):
    class Watcher(pl.Callback):
        def on_train_batch_end(self, trainer, agent, *_):
            agent.evaluate()
            agent.act(agent.task.observations)
            torch.rand(3)

    watched, alone = make_agent(), make_agent()
    fit(watched, tmp_path, max_epochs=1, callbacks=[Watcher()])
    fit(alone, tmp_path, max_epochs=1)
    assert_same_state(watched, alone)


def test_training_leaves_the_global_generator_alone(tmp_path):
    torch.manual_seed(5)
    expected = torch.rand(3)
    agent = make_agent()
    data = RolloutDataModule(agent.task, 4, 10)
    agent.update_rule.loss(agent.coming_chain(), data.train_dataloader().dataset[0])
    torch.manual_seed(5)
    agent.evaluate()
    assert torch.equal(torch.rand(3), expected)


@pytest.mark.parametrize(
    "agent",
    [
        make_agent(),
        Agent(
            TableTask([[1.0, 0.0], [0.0, 2.0]], [0.25, 0.75], observations="index"),
            Table,
            partial(Multinomial, reference=1, start=[[0.5, -0.5, 0.0]]),
            percepts=Discrete(3),
            update_rule=ExactGradient(),
        ),
        Agent(
            TargetTask([[0.0], [1.0]], observations="index"),
            Gaussian,
            partial(MLP, hidden=(4, 4), activation=torch.nn.ReLU),
            percepts=Box(-3, 3, (2,)),
            marginals=BatchMarginals(),
        ),
    ],
    ids=["predator-prey", "table", "continuous"],
)
def test_a_checkpoint_alone_rebuilds_the_agent(agent, tmp_path, monkeypatch):
    monkeypatch.setattr("bra.evaluation.tables.SUPPORT_SIZE", 64)
    fit(agent, tmp_path, max_epochs=1).save_checkpoint(tmp_path / "agent.ckpt")
    loaded = Agent.load_from_checkpoint(tmp_path / "agent.ckpt")
    assert_same_state(loaded, agent)
    assert loaded.evaluate() == agent.evaluate()
    assert type(loaded.update_rule) is type(agent.update_rule)
    assert loaded.percept_space == agent.percept_space
    assert loaded.beta_action == agent.beta_action


def test_a_checkpoint_holds_the_table_of_a_file_that_is_gone(tmp_path):
    table = tmp_path / "utilities.csv"
    table.write_text("state,stay,flee\nmouse,3,1\nlion,0,5\n")
    agent = Agent(TableTask(table))
    fit(agent, tmp_path, max_epochs=1).save_checkpoint(tmp_path / "agent.ckpt")
    table.unlink()
    loaded = Agent.load_from_checkpoint(tmp_path / "agent.ckpt", beta_action=3.0)
    assert loaded.task.action_names == ("stay", "flee")
    assert loaded.beta_action == 3.0
    assert torch.equal(loaded.behaviour(), agent.behaviour())


def test_a_checkpoint_of_another_task_is_refused(tmp_path):
    trainer = fit(make_agent(), tmp_path, max_epochs=1)
    trainer.save_checkpoint(tmp_path / "agent.ckpt")
    other = Agent(PredatorPrey("mating"), percepts=5)
    with pytest.raises(ValueError, match=r"has task PredatorPrey\(variant=hunting.*this agent"):
        fit(other, tmp_path, ckpt_path=tmp_path / "agent.ckpt", max_epochs=2)
    torch.save({"state_dict": {}}, tmp_path / "foreign.ckpt")
    with pytest.raises(ValueError, match=r"foreign.ckpt is no checkpoint of a bra.Agent"):
        Agent.load_from_checkpoint(tmp_path / "foreign.ckpt")


def test_diverging_parameters_stop_the_run(tmp_path):
    agent = make_agent(perception_optimizer=partial(ExplodingSGD, lr=1.0))
    with pytest.raises(
        FloatingPointError, match=r"perception channel's parameters ran away.*learning rate"
    ):
        fit(agent, tmp_path, max_epochs=3)


@pytest.mark.parametrize(
    ("numbers", "lost"),
    [
        ((math.nan, 0.0), True),
        ((math.inf, -math.inf), True),
        ((2e30, -2e30), True),
        ((2e30, 0.0), True),
        ((0.9e30, 0.9e30), False),  # large in sum only
    ],
)
def test_parameters_that_ran_away(tmp_path, numbers, lost):
    agent = make_agent()
    with torch.no_grad():
        next(agent.perception.parameters()).view(-1)[:2] = torch.tensor(numbers)
    with pytest.raises(FloatingPointError, match="ran away") if lost else nullcontext():
        fit(agent, tmp_path, max_epochs=1)


@pytest.mark.parametrize("available", [True, False])
def test_optimizers_do_not_ask_for_gpus_that_are_not_there(tmp_path, monkeypatch, available):
    monkeypatch.setenv("PYTORCH_NVML_BASED_CUDA_CHECK", "1")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: available)
    loop = SimpleNamespace(setup_data=lambda: None)
    length = {"fit_loop": loop, "estimated_stepping_batches": 10}
    agent = make_agent()
    parts = {
        "datamodule": None,
        "train_dataloader": (),
        "optimizers": agent.configure_optimizers()[0],
        "lr_scheduler_configs": (),
    }
    trainer = SimpleNamespace(is_global_zero=True, **length, **parts)
    monkeypatch.setattr(Agent, "trainer", trainer)
    agent.on_fit_start()
    assert os.environ["PYTORCH_NVML_BASED_CUDA_CHECK"] == ("1" if available else "0")


class ExplodingSGD(torch.optim.SGD):
    """Steps to infinity, as a learning rate that is too large does sooner or later."""

    def step(self, closure=None):
        super().step(closure)
        with torch.no_grad():
            self.param_groups[0]["params"][0].fill_(float("inf"))


@pytest.mark.parametrize(("decay", "said"), [(0.5, True), (0.98, False)])
def test_batches_that_make_information_too_cheap_are_noted(decay, said, tmp_path, capsys):
    agent = Agent(
        PredatorPrey(), update_rule=ScoreFunction(), marginals=RunningMarginals(decay), seed=0
    )
    trainer = make_trainer(tmp_path, max_epochs=1)
    trainer.fit(agent, RolloutDataModule(agent.task, batch_size=1, updates_per_epoch=2))
    note = "note: with batches of 1 RunningMarginals find I(ξ;X) too small by 0.33 times"
    assert (note in capsys.readouterr().out) is said
