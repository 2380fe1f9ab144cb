"""Blocks of updates are the updates that they stand for."""

import copy
import logging
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import lightning.pytorch as pl
import numpy as np
import pytest
import torch
from block_runs import SETTINGS, Looks, fit
from lightning.pytorch.callbacks import ModelCheckpoint
from torch.optim import SGD

from bra import Agent, PredatorPrey
from bra.blocks.loop import cache_folder, compile_loop
from bra.channels import MLP
from bra.update_rules import ScoreFunction

EPOCH = 70


def assert_same(one, other):
    ours, theirs = one.state_dict(), other.state_dict()
    for name, tensor in ours.items():
        assert torch.equal(tensor, theirs[name]), name
    assert (one.updates, one.samples) == (other.updates, other.samples)
    assert torch.equal(one.terms.objective, other.terms.objective)


def test_any_length_of_blocks_gives_the_same_agent(tmp_path):
    """To the last bit, also after a cut; and but for rounding that of single updates."""
    through = Agent(**SETTINGS)
    trainer = fit(through, tmp_path, EPOCH)
    assert trainer.global_step == through.updates == 2 * EPOCH
    assert through.samples == 4 * EPOCH
    for every in (1, 7, 64):
        agent, looks = Agent(**SETTINGS), Looks(every)
        fit(agent, tmp_path, EPOCH, callbacks=[looks])
        assert_same(agent, through)
        assert {*range(every, 2 * EPOCH, every), EPOCH, 2 * EPOCH} <= {*looks.seen}

    saves = ModelCheckpoint(tmp_path, "cut", every_n_train_steps=EPOCH + 13)
    stopped = {"callbacks": [saves], "enable_checkpointing": True, "max_steps": EPOCH + 20}
    assert fit(Agent(**SETTINGS), tmp_path, EPOCH, **stopped).global_step == EPOCH + 20
    resumed = Agent(**SETTINGS)
    fit(resumed, tmp_path, EPOCH, ckpt_path=tmp_path / "cut.ckpt")
    assert_same(resumed, through)

    eager = Agent(**(SETTINGS | {"compile": False}))
    fit(eager, tmp_path, EPOCH)
    for name, tensor in eager.state_dict().items():
        torch.testing.assert_close(tensor, through.state_dict()[name], rtol=1e-4, atol=1e-5)


@pytest.mark.slow
def test_blocks_of_a_thousand_updates_give_the_same_agent(tmp_path):
    agents = [Agent(**SETTINGS) for _ in range(4)]
    for agent, every in zip(agents, (1, 7, 64, 1000), strict=True):
        looks = Looks(every)
        fit(agent, tmp_path, 1050, callbacks=[looks], limit_val_batches=0)
        assert {*range(every, 2100, every)} <= {*looks.seen}
        assert_same(agent, agents[0])


def test_blocks_are_long_where_nobody_looks(tmp_path):
    agent, looks = Agent(**SETTINGS), Looks(None)
    fit(agent, tmp_path, callbacks=[looks], limit_val_batches=0)
    assert len(looks.seen) <= 4 and looks.seen[-1] == 300
    assert fit(Agent(**SETTINGS), tmp_path, limit_train_batches=70).global_step == 140


def test_validation_ends_blocks(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(Agent, "validation_step", lambda self, *_: seen.append(self.updates))
    trainer = fit(Agent(**SETTINGS), tmp_path, 120, val_check_interval=50, num_sanity_val_steps=0)
    assert seen == [50, 100, 170, 220]
    assert trainer.global_step == 240


class Counting(ScoreFunction):
    """Remembers in Python how often it was asked."""

    def __init__(self):
        super().__init__()
        self._calls = 0

    def loss(self, chain, world):
        self._calls += 1
        loss, terms = super().loss(chain, world)
        return loss * (1 + self._calls % 2), terms


class Deciding(ScoreFunction):
    """Looks at the number of the update."""

    def loss(self, chain, world):
        loss, terms = super().loss(chain, world)
        return (loss if chain.update > 2 else 2 * loss), terms


class Dropping(MLP):
    """Draws from torch's generator."""

    def forward(self, condition):
        return super().forward(condition * (torch.rand(()) < 0.9))


class Shuffling(MLP):
    """Draws from NumPy's generator."""

    def forward(self, condition):
        return super().forward(condition * np.random.rand())


class Noting(ScoreFunction):
    """Remembers in a tensor that is no buffer."""

    def __init__(self):
        super().__init__()
        self.seen = torch.zeros(())

    def loss(self, chain, world):
        self.seen += 1
        return super().loss(chain, world)


class Waning(PredatorPrey):
    """Remembers in Python, and is no module."""

    asked = 0

    def utility(self, state, action):
        self.asked += 1
        return super().utility(state, action) / self.asked


class OwnDescent(SGD):
    """An optimizer that nobody knows."""


class Watching(pl.Callback):
    """Looks at every update."""

    def on_train_batch_end(self, *_):
        pass


@pytest.mark.parametrize(
    ("own", "reason"),
    [
        ({"update_rule": Counting()}, "Counting._calls changes"),
        ({"update_rule": Noting()}, "Noting.seen changes"),
        ({"task": Waning()}, "Waning.asked changes"),
        ({"perception": Shuffling}, "draws from default generators"),
        ({"update_rule": Deciding()}, "ontrol"),
        ({"perception": Dropping}, "draws from default generators"),
        ({"action_optimizer": partial(OwnDescent, lr=0.1)}, "OwnDescent is none of SGD, Adam"),
        ({}, "Watching is called at every update"),
    ],
)
def test_what_cannot_be_compiled_is_trained_update_by_update(tmp_path, caplog, own, reason):
    caplog.set_level(logging.INFO, "bra")
    settings = [SETTINGS | copy.deepcopy(own) | {"compile": compile} for compile in (False, True)]
    agents = [Agent(**own_settings) for own_settings in settings]
    callbacks = [] if own else [Watching()]
    for agent in agents:
        np.random.seed(0)
        fit(agent, tmp_path, 5, callbacks=callbacks)
    (line,) = [r.getMessage() for r in caplog.records if "one by one" in r.getMessage()]
    assert reason in line and "\n" not in line
    assert_same(*agents)


class Mine(Agent):
    """Updates in a way of its own."""

    def find_gradient(self, world):
        super().find_gradient(world)
        self.action.eta.grad.zero_()


def test_updates_of_ones_own_are_made(tmp_path, caplog):
    caplog.set_level(logging.INFO, "bra")
    agent = Mine(**SETTINGS)
    before = agent.action.eta.detach().clone()
    fit(agent, tmp_path, 3)
    assert "Mine.find_gradient is somebody's own" in caplog.text
    assert torch.equal(agent.action.eta, before)


@pytest.mark.parametrize("damaged", [True, False])
def test_damaged_files_are_made_anew(tmp_path, monkeypatch, damaged):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    path = cache_folder() / "kind.pt2"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"" if damaged else b"whole")

    def load(name):
        if not Path(name).read_bytes():
            raise RuntimeError("no package")
        return Path(name).read_bytes()

    monkeypatch.setattr("bra.blocks.loop._fingerprint", lambda *_: "kind")
    monkeypatch.setattr("bra.blocks.loop._compile", lambda *a: a[-1].write_bytes(b"new"))
    monkeypatch.setattr("torch._inductor.aoti_load_package", load)
    assert compile_loop(None, None) == (b"new" if damaged else b"whole")


def test_auto_compiles_long_runs_only(tmp_path, monkeypatch):
    agent = Agent(**(SETTINGS | {"compile": "auto"}))
    fit(agent, tmp_path, 3)
    assert agent._blocks is None
    monkeypatch.setattr("bra.agent.trained.PAYS", 100)
    fit(Agent(**(SETTINGS | {"compile": "auto"})), tmp_path, 3, callbacks=[looks := Looks(None)])
    assert looks.seen == [*range(1, 7)]
    with pytest.raises(ValueError, match="compile must be auto, true or false, got 'yes'"):
        Agent(**(SETTINGS | {"compile": "yes"}))


@pytest.mark.slow
def test_an_agent_that_runs_away_is_stopped(tmp_path):
    agent = Agent(**(SETTINGS | {"action_optimizer": partial(SGD, lr=1e38)}))
    with pytest.raises(FloatingPointError, match="action channel's parameters ran away"):
        fit(agent, tmp_path, 20)


@pytest.mark.slow
def test_processes_leave_no_compiled_code_behind(tmp_path):
    """But in the cache: what is loaded from there lies in a temporary folder."""
    data = ["--data.task=PredatorPrey", "--data.updates_per_epoch=200"]
    model = ["--model.percepts=3", "--model.beta_perception=8", "--model.beta_action=10"]
    args = ["fit", *data, *model, "--model.compile=true", "--trainer.max_epochs=1"]
    said = subprocess.run(
        [sys.executable, "-m", "bra", *args, f"--trainer.default_root_dir={tmp_path}"],
        env={**os.environ, "TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "one by one" not in said.stderr
    assert not list(tmp_path.glob("aotinductor*"))
