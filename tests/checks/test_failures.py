"""Errors of classes of one's own: whose they are, in which update, and where in their code."""

import re

import lightning.pytorch as pl
import pytest
from training import fit

from bra import Agent, PredatorPrey, RolloutDataModule
from bra.channels import MLP
from bra.checks.failures import add_note, find_note, own_line, own_text
from bra.cli import main
from bra.critics import TableCritic
from bra.tasks import WorldError
from bra.update_rules import Projection, ScoreFunction


def camera(kind=ValueError):
    raise kind("the camera shows nothing")


class Drawing(PredatorPrey):
    kind = ValueError

    def sample_streams(self, count, streams, update):
        return camera(self.kind) if update == 2 else super().sample_streams(count, streams, update)


class Disconnected(Drawing):
    kind = ConnectionError


class Blind(Drawing):
    kind = WorldError


class Valuing(PredatorPrey):
    asked = 0

    def utility(self, state, action):
        self.asked += 1
        return camera() if self.asked == 3 else super().utility(state, action)


class Perceiving(MLP):
    def forward(self, condition):
        return camera() if self.training and self.seen() == 3 else super().forward(condition)

    def seen(self):
        self.calls = getattr(self, "calls", 0) + 1
        return self.calls


class Learning(TableCritic):
    def learn(self, *_):
        camera()


class Ruling(ScoreFunction):
    def loss(self, chain, world):
        return camera() if chain.update == 2 else super().loss(chain, world)


class Calling(pl.Callback):
    def on_train_batch_end(self, trainer, *_):
        if trainer.global_step == 2:
            camera()


OWN = {
    "Drawing.sample_streams": {"task": Drawing()},
    "Valuing.utility": {"task": Valuing()},
    "Perceiving.forward": {"perception": Perceiving},
    "Learning.learn": {"update_rule": Projection(critic=Learning(1.0))},
    "Ruling.loss": {"update_rule": Ruling()},
    "Calling.on_train_batch_end": {},
}


@pytest.mark.parametrize("name", OWN)
def test_an_error_names_class_method_and_update(tmp_path, name):
    parts = {"task": PredatorPrey(), "update_rule": ScoreFunction(), "percepts": 3, "seed": 0}
    agent = Agent(**parts | {"perception": MLP} | OWN[name])
    callbacks = [Calling()] if name.startswith("Calling") else []
    with pytest.raises(ValueError, match=r"^the camera shows nothing\n") as caught:
        fit(agent, tmp_path, max_epochs=1, callbacks=callbacks)
    assert caught.value.__notes__ == [f"raised by {name} in update {agent.updates}"]
    assert caught.traceback[-1].name == "camera"


def test_other_phases_are_named(tmp_path):
    agent = Agent(PredatorPrey(), seed=0)
    trainer = fit(agent, tmp_path, max_epochs=1)
    agent.task = Valuing()
    agent.task.asked = 2
    with pytest.raises(ValueError, match="nothing") as caught:
        trainer.predict(agent, RolloutDataModule(agent.task))
    assert caught.value.__notes__ == ["raised by Valuing.utility in predict"]


def test_errors_that_are_nobodys_own_have_no_note(tmp_path):
    with pytest.raises(ValueError, match="the data module draws worlds") as caught:
        agent = Agent(PredatorPrey("mating"), seed=0)
        agent.recipe, agent.task = {}, PredatorPrey()
        pl.Trainer(default_root_dir=tmp_path, logger=False, enable_checkpointing=False).fit(
            agent, RolloutDataModule(PredatorPrey("mating"))
        )
    assert not find_note(caught.value)


@pytest.mark.parametrize("task", [Disconnected(), Blind()])
def test_errors_in_a_worker_keep_name_and_traceback(task):
    batches = RolloutDataModule(task, workers=1).train_dataloader()
    with pytest.raises(task.kind) as caught:
        list(batches)
    note = f"raised by {type(task).__name__}.sample_streams in update 2"
    assert find_note(caught.value) == note
    if task.kind is WorldError:
        assert str(caught.value) == "the camera shows nothing"
    else:
        assert "raise kind(" in own_text(caught.value)
        assert own_line(caught.value) == f"ConnectionError: the camera shows nothing; {note}"


def test_without_workers_a_lost_connection_is_no_dead_worker():
    with pytest.raises(ConnectionError, match=r"^the camera shows nothing\n"):
        list(RolloutDataModule(Disconnected()).train_dataloader())


@pytest.mark.parametrize("command", ["fit", "baseline"])
def test_the_command_ends_with_the_own_traceback_and_one_line(
    tmp_path, monkeypatch, capsys, command
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own_task.py").write_text(
        "from bra.tasks import Task, World\n"
        "from gymnasium.spaces import Box, Discrete\n"
        "import torch\n"
        "class Tiny(Task):\n"
        "    observation_space, action_space = Box(0, 1, (2,)), Discrete(2)\n"
        "    def sample(self, count, generator):\n"
        "        return World(torch.rand(count, 2, generator=generator), torch.rand(count, 2))\n"
        "    def utility(self, state, action):\n"
        "        return state['left']\n"
        "    def grid(self, points):\n"
        "        return {}['points']\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    words = ["--data.task=own_task.Tiny", "--model.percepts=2"]
    words += ["--trainer.enable_progress_bar=false"]
    words += ["--baseline=null"] if command == "fit" else []
    with pytest.raises(SystemExit) as end:
        main([command, *words])
    said = capsys.readouterr().err.strip()
    assert end.value.code == 2
    lines = {
        "fit": "error: IndexError: .* raised by Tiny.utility in update 0",
        "baseline": "error: KeyError: 'points'; raised by Tiny.grid in bra baseline",
    }
    assert re.fullmatch(lines[command], said.splitlines()[-1]), said
    assert "own_task.py" in said and "lightning" not in said


def test_notes_are_written_once():
    try:
        camera()
    except ValueError as error:
        add_note(error, "in update 1")
        add_note(error, "in update 2")
        assert error.__notes__ == ["raised by test_notes_are_written_once in update 1"]


def test_errors_that_are_their_own_context_end():
    one, other = OSError("one"), OSError("other")
    one.__context__, other.__context__ = other, one
    add_note(one, "in update 3")
    assert not find_note(one)
