"""What monitors hand on: to loggers, and to callbacks of others."""

import csv
from pathlib import Path

import lightning.pytorch as pl
import pytest
from lightning.pytorch.callbacks import EarlyStopping
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import bra
from bra.callbacks import BaselineMonitor
from bra.callbacks.monitors import MONITORS


def fit(folder, *callbacks, epochs=1, updates=20, logger=True, **own):
    agent = bra.Agent(bra.TableTask([[3, 1], [0, 5]]), percepts=2, seed=0, **own)
    trainer = pl.Trainer(
        max_epochs=epochs,
        callbacks=[*bra.monitors(), *callbacks],
        default_root_dir=folder,
        logger=logger,
        enable_checkpointing=False,
        enable_model_summary=False,
        accelerator="cpu",
    )
    trainer.fit(agent, bra.RolloutDataModule(agent.task, 1, updates))
    return trainer, agent


def test_monitors_are_those_of_the_command():
    assert {type(monitor) for monitor in bra.monitors()} >= set(MONITORS.values())
    assert all(one is not other for one, other in zip(bra.monitors(), bra.monitors(), strict=True))


def test_a_run_may_stop_where_the_gap_is_closed(tmp_path):
    stop = EarlyStopping("objective/gap", patience=10**6, stopping_threshold=1e-3)
    trainer, agent = fit(tmp_path, stop, epochs=20, updates=50, beta_perception=3.0)
    assert 0 < agent.updates < 1000
    assert trainer.callback_metrics["objective/gap"] <= 1e-3
    assert trainer.callback_metrics["objective/J"].item() == pytest.approx(
        agent.evaluate().objective
    )


def test_tensorboard_compares_runs(tmp_path):
    board = TensorBoardLogger(tmp_path)
    _, agent = fit(tmp_path, logger=board, beta_perception=2.0)
    events = EventAccumulator(board.log_dir)
    events.Reload()
    assert {"run/J", "run/gap", "run/hit_rate"} <= {*events.Tags()["scalars"]}
    (last,) = events.Scalars("run/J")
    assert last.value == pytest.approx(agent.evaluate().objective)
    plugin = events.summary_metadata["_hparams_/session_start_info"].plugin_data.content
    assert b"action_bits" not in plugin  # of budgets that there are none of
    for name in (b"beta_perception", b"update_rule", b"Projection", b"TableTask"):
        assert name in plugin


def test_other_loggers_have_curves_and_hyperparameters(tmp_path):
    log = CSVLogger(tmp_path, flush_logs_every_n_steps=1)
    fit(tmp_path, logger=log)
    with (Path(log.log_dir) / "metrics.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert any(row.get("objective/gap") for row in rows)
    assert "beta_perception: 1.0" in (Path(log.log_dir) / "hparams.yaml").read_text()


def test_the_bound_of_a_run_may_be_certified(tmp_path):
    task = bra.PredatorPrey()
    bounds = []
    for certify in (None, 1.5):
        monitor = BaselineMonitor(certify=certify)
        agent = bra.Agent(task, percepts=9, beta_perception=1.0, beta_action=10.0, seed=0)
        trainer = pl.Trainer(
            max_epochs=1, callbacks=[monitor], default_root_dir=tmp_path, logger=False,
            enable_checkpointing=False, enable_model_summary=False, enable_progress_bar=False,
            accelerator="cpu",
        )  # fmt: skip
        trainer.fit(agent, bra.RolloutDataModule(task, 1, 1))
        bounds.append(monitor.reference(agent).bound)
    assert 2.5601 < bounds[1] < bounds[0] - 1e-3
