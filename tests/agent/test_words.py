"""What agents, and what they are made of, say of themselves; and what trainers say of them."""

import logging

import lightning.pytorch as pl
import pytest
import torch
from lightning.pytorch.callbacks import ModelSummary

import bra
from bra.tasks import FiniteTask


def test_tasks_say_what_they_are_made_of():
    task = bra.TableTask([[3, 1], [0, 5]], prior=[0.75, 0.25])
    spaces = "ξ Box(0.0, 1.0, (2,), float32), a Discrete(2)"
    assert repr(task) == f"TableTask(utilities=[[3, 1], [0, 5]], prior=[0.75, 0.25]): {spaces}"
    assert repr(bra.TableTask(torch.rand(9, 3))).startswith("TableTask(utilities=<9×3>): ξ Box")
    assert repr(bra.PredatorPrey("mating")).startswith("PredatorPrey(variant='mating'): ξ Box")
    assert repr(bra.Cooling()) == "Cooling(factor=4.0, updates=0.4, action_factor=None)"


def test_a_task_that_is_not_ready_has_words_all_the_same():
    assert repr(FiniteTask.__new__(FiniteTask, 1, 2, 3, 4, 5, 6, 7, 8, 9)).startswith("<bra.tasks")


def test_channels_say_between_which_spaces_they_lie():
    agent = bra.Agent(bra.PredatorPrey(), percepts=13)
    assert repr(agent.action) == "Multinomial(Discrete(13) → Discrete(9))"
    assert "Box(0.0, 1.0, (4,), float32) → Discrete(13)" in repr(agent.perception)


def test_agents_name_their_parts_and_prices():
    agent = bra.Agent(bra.PredatorPrey(), beta_perception=8.0, seed=3)
    lines = repr(agent).splitlines()
    assert lines[0] == "Agent("
    assert "  β₁ 8, β₂ 1, seed 3" in lines
    assert "  update rule: Projection(rivals=Rivals())" in lines
    assert "  0 updates" in lines
    population = bra.Population(bra.PredatorPrey(), replicas=4, seed=3)
    assert "  β₁ 1, β₂ 1, seed 3, and 3 other agents" in repr(population)


class Told(logging.Handler):
    """Collects what Lightning logs."""

    def __init__(self):
        super().__init__()
        self.lines = []

    def emit(self, record):
        self.lines.append(record.getMessage())


@pytest.fixture
def told(monkeypatch):
    handler = Told()
    for name in ("lightning.pytorch", "lightning.fabric"):
        logger = logging.getLogger(name)
        monkeypatch.setattr(logger, "level", logging.INFO)
        monkeypatch.setattr(logger, "handlers", [handler])
        logger.manager._clear_cache()
    return handler.lines


def fit(folder, **own):
    task = bra.TableTask([[3, 1], [0, 5]])
    agent = bra.Agent(task, percepts=2, seed=0)
    trainer = pl.Trainer(max_epochs=1, default_root_dir=folder, enable_progress_bar=False, **own)
    trainer.fit(agent, bra.RolloutDataModule(task, 1, 3))


def test_a_run_prints_nothing_but_its_own(tmp_path, capsys, told):
    fit(tmp_path)
    printed = capsys.readouterr()
    assert [line[:6] for line in printed.out.splitlines()] == ["chosen"]
    assert printed.err == ""
    assert told == []


def test_a_summary_that_is_asked_for_is_printed(tmp_path, told):
    fit(tmp_path, callbacks=[ModelSummary(max_depth=2)])
    assert any("perception.network" in line for line in told)
