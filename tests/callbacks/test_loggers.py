"""What loggers of every kind are given."""

import csv
from pathlib import Path

import lightning.pytorch as pl
import numpy as np
import pytest
from lightning.pytorch.loggers import CSVLogger, MLFlowLogger, TensorBoardLogger
from lightning.pytorch.loggers.logger import Logger
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar.layout_pb2 import Layout

import bra
from bra.callbacks import BaselineMonitor, BehaviourFigures, InformationMonitor

FIGURES = {
    f"behaviour/p_{name}"
    for name in ("action_given_state", "percept_given_state", "action_given_percept")
}
TASK = bra.TableTask([[3, 1], [0, 5]])


def fit(folder, logger, task=TASK, updates=16, monitors=None):
    agent = bra.Agent(task, percepts=2, beta_perception=2.0, seed=0)
    trainer = pl.Trainer(
        max_epochs=1,
        callbacks=bra.monitors() if monitors is None else monitors,
        default_root_dir=folder,
        logger=logger,
        enable_checkpointing=False,
        enable_model_summary=False,
        accelerator="cpu",
    )
    data = bra.RolloutDataModule(agent.task, 1, updates)
    trainer.fit(agent, data)
    return trainer, agent, data


def read_events(board):
    board.experiment.flush()
    events = EventAccumulator(board.log_dir, size_guidance={"images": 0})
    events.Reload()
    return events


@pytest.fixture(scope="module")
def events(tmp_path_factory):
    """Of a run with all monitors."""
    folder = tmp_path_factory.mktemp("board")
    board = TensorBoardLogger(folder)
    fit(folder, board)
    return read_events(board)


def test_tensorboard_has_pictures_of_the_whole_run(events):
    assert {*events.Tags()["images"]} == FIGURES
    for tag in FIGURES:
        assert [image.step for image in events.Images(tag)] == [0, 2, 4, 6, 8, 10, 12, 14, 16]


def test_the_optimum_is_a_curve_beside_each_of_the_agents(events):
    optimum = bra.blahut_arimoto.serial(TASK.utilities, TASK.prior, 2, 2.0, 1.0, seed=0)
    for term in ("expected_utility", "perception_bits", "action_bits", "end_to_end_bits"):
        assert len({point.value for point in events.Scalars(f"optimum/{term}")}) == 1
    (last,) = {point.value for point in events.Scalars("optimum/expected_utility")}
    assert last == pytest.approx(optimum.expected_utility)
    (last,) = {point.value for point in events.Scalars("optimum/action_bits")}
    assert last == pytest.approx(optimum.action_information / np.log(2), abs=1e-6)


def test_curves_have_the_same_markers_in_every_run(events):
    (config,) = events.Tensors("custom_scalars__config__")
    layout = Layout.FromString(config.tensor_proto.string_val[0])
    charts = {
        chart.title: [(curve.value, curve.lower, curve.upper) for curve in chart.margin.series]
        for category in layout.category
        for chart in category.chart
    }
    assert [chart.title for chart in layout.category[0].chart] == ["J, its optimum and its bound"]
    names = ["J", "blahut_arimoto", "upper_bound", "without_sensor_noise"]
    assert charts["J, its optimum and its bound"] == [(f"objective/{n}",) * 3 for n in names]
    pair = ("information/perception_bits",) * 3, ("optimum/perception_bits",) * 3
    assert charts["I(Ω;X) in bits, of agent and optimum"] == [*pair]


@pytest.mark.parametrize("phase", ["validate", "test"])
def test_evaluations_stand_at_the_agents_update(phase, tmp_path):
    _, agent, data = fit(tmp_path, False, monitors=[])
    board = TensorBoardLogger(tmp_path)
    trainer = pl.Trainer(logger=board, default_root_dir=tmp_path, accelerator="cpu")
    getattr(trainer, phase)(agent, data, verbose=False)
    (point,) = read_events(board).Scalars("objective/J")
    assert point.step == agent.updates == 16
    assert point.value == pytest.approx(agent.evaluate().objective)


def test_a_csv_log_has_one_row_per_look_and_pictures_beside_it(tmp_path):
    log = CSVLogger(tmp_path)
    every = [InformationMonitor(every_n_updates=4), BaselineMonitor(every_n_updates=12)]
    figures = [m for m in bra.monitors() if type(m).__name__ == "BehaviourFigures"]
    fit(tmp_path, log, monitors=[*every, *figures])
    with (Path(log.log_dir) / "metrics.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == [0, 4, 8, 12, 16]
    assert [bool(row["objective/gap"]) for row in rows] == [True, False, False, True, True]
    for row in (rows[0], *rows[3:]):
        assert float(row["objective/J"]) == pytest.approx(
            float(row["objective/blahut_arimoto"]) - float(row["objective/gap"])
        )
    found = {path.relative_to(log.log_dir).as_posix() for path in Path(log.log_dir).rglob("*.png")}
    assert found == {f"{tag}-{step:07}.png" for tag in FIGURES for step in range(0, 17, 2)}


def test_rows_of_a_csv_log_are_on_disk_while_the_run_goes_on(tmp_path):
    class Reader(pl.Callback):
        def on_train_batch_start(self, trainer, agent, *_):
            lines = (Path(log.log_dir) / "metrics.csv").read_text().splitlines()
            assert len(lines) == 2 + agent.updates // 5  # with the header

    log = CSVLogger(tmp_path)
    fit(tmp_path, log, monitors=[InformationMonitor(5), BaselineMonitor(8, 5), Reader()])


def test_mlflow_has_curves_and_pictures(tmp_path, monkeypatch):
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    log = MLFlowLogger(tracking_uri=f"file:{tmp_path / 'store'}")
    _, agent, _ = fit(tmp_path, log)
    client = log.experiment
    run = client.get_run(log.run_id).data
    assert run.metrics["objective/J"] == pytest.approx(agent.evaluate().objective)
    assert [m.step for m in client.get_metric_history(log.run_id, "objective/J")] == [0, 16]
    assert run.params["beta_perception"] == "2.0"
    pictures = list((tmp_path / "store").rglob("behaviour?p_action_given_state?step?16?*.png"))
    assert Image.open(pictures[0]).size == behaviour_size(agent)


def behaviour_size(agent):
    from bra.callbacks.baseline import solve_reference
    from bra.callbacks.behaviour import behaviour_figures

    return behaviour_figures(agent, solve_reference(agent).optimum)["p_action_given_state"].size


@pytest.mark.parametrize(
    ("run", "every"), [(3, 1), (80, 10), (800, 100), (2000, 300), (40000, 5200)]
)
def test_pictures_are_drawn_some_eight_times_and_when_others_look(run, every, tmp_path):
    agent = bra.Agent(TASK, percepts=2, seed=0)
    agent.run = run
    monitor = BehaviourFigures()
    monitor.on_train_start(pl.Trainer(logger=False, default_root_dir=tmp_path), agent)
    assert monitor.every_n_updates == every


@pytest.mark.parametrize(
    ("run", "every"), [(3, 100), (10_000, 100), (25_000, 300), (100_000, 1000)]
)
def test_curves_have_a_hundred_points_in_long_runs(run, every, tmp_path):
    agent = bra.Agent(TASK, percepts=2, seed=0)
    agent.run = run
    monitor = InformationMonitor()
    monitor.on_train_start(pl.Trainer(logger=False, default_root_dir=tmp_path), agent)
    assert monitor.every_n_updates == every


@pytest.mark.parametrize(
    ("replicas", "every", "drawn"), [(256, 100, 1300), (257, 200, 1400), (600, 300, 1500)]
)
def test_many_agents_are_judged_less_often(replicas, every, drawn, tmp_path, monkeypatch):
    population = bra.Population(TASK, replicas=1, percepts=2, seed=0)
    many = population.settings * replicas
    monkeypatch.setattr(bra.Population, "settings", many)
    population.run = 10_000
    monitors = (InformationMonitor(), InformationMonitor(70), BehaviourFigures())
    for monitor, expected in zip(monitors, (every, 70, drawn), strict=True):
        monitor.on_train_start(pl.Trainer(logger=False, default_root_dir=tmp_path), population)
        assert monitor.every_n_updates == expected


class Gallery(Logger):
    """Takes pictures as WandbLogger does, by its signature and names of arguments."""

    name, version = "gallery", 0

    def __init__(self):
        super().__init__()
        self.shown = []

    def log_image(self, key, images, step=None, **kwargs):
        assert not kwargs
        self.shown += [(key, step, image.size) for image in images]

    def log_metrics(self, metrics, step=None): ...

    def log_hyperparams(self, params): ...


class Deaf(Logger):
    """Takes no pictures."""

    name, version = "deaf", 0

    def log_metrics(self, metrics, step=None): ...

    def log_hyperparams(self, params): ...


def test_weights_and_biases_is_given_pictures_in_its_own_way(tmp_path):
    gallery = Gallery()
    _, agent, _ = fit(tmp_path, [gallery, Deaf()])
    assert {key for key, *_ in gallery.shown} == FIGURES
    assert {step for _, step, _ in gallery.shown} == {*range(0, 17, 2)}
    assert {*gallery.shown} >= {("behaviour/p_action_given_state", 16, behaviour_size(agent))}


@pytest.mark.parametrize("names", [["$1_$", "$$"], ["鼠", "獅子"], ["🐭", "🦁"], ["a\nb", "%s {}"]])
def test_names_of_any_letters_break_nothing(names, tmp_path):
    task = bra.TableTask([[3, 1], [0, 5]], state_names=names, action_names=names)
    fit(tmp_path, [TensorBoardLogger(tmp_path), CSVLogger(tmp_path)], task, 2)
    assert len(list(tmp_path.rglob("p_action_given_state-*.png"))) == 3
