"""What runs write, and that they never write over what is not theirs."""

import multiprocessing
from functools import partial
from pathlib import Path

import lightning.pytorch as pl
import pytest
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger

from bra import Agent, RolloutDataModule
from bra.agent.run_folder import claim_folders, new_file, run_folder
from bra.callbacks import RunSummary
from bra.cli import main
from bra.tasks import PredatorPrey

TASK = "--data.task=PredatorPrey"
QUICK = ["--trainer.max_epochs=1", "--data.updates_per_epoch=4", "--data.evaluation_worlds=4"]
QUIET = ["--trainer.enable_progress_bar=false", "--behaviour=null", "--baseline=null"]
SHORT = [TASK, *QUICK, *QUIET]
THEIRS = ("config.yaml", "summary.json", "rollouts.csv", "population.csv")


@pytest.mark.parametrize(
    ("command", "option"),
    [
        ("fit", "--trainer.fast_dev_run=true"),
        *(
            (command, "--trainer.logger=false")
            for command in ("fit", "validate", "test", "predict")
        ),
    ],
)
def test_files_of_the_current_folder_stay_as_they_are(command, option):
    for name in THEIRS:
        Path(name).write_text("mine")
    several = ["--model.replicas=2"] if command == "fit" else []
    main([command, *SHORT, option, *several])
    main([command, *SHORT, option, *several])
    assert all(Path(name).read_text() == "mine" for name in THEIRS)
    assert {path.name for path in Path().iterdir()} == {*THEIRS, "lightning_logs"}
    assert len([*Path("lightning_logs").iterdir()]) == 2


def test_a_run_without_logger_keeps_all_in_one_folder():
    main(["fit", *SHORT, "--trainer.logger=false"])
    found = {p.as_posix() for p in Path().rglob("*") if p.is_file()}
    names = ("config.yaml", "summary.json", "checkpoints/last.ckpt")
    assert found >= {f"lightning_logs/version_0/{name}" for name in names}
    assert all(path.startswith("lightning_logs/version_0/") for path in found)


def test_a_folder_given_twice_keeps_what_the_first_run_wrote():
    fixed = ["--trainer.logger=TensorBoardLogger", "--trainer.logger.save_dir=logs"]
    fixed += ["--trainer.logger.version=mine"]
    main(["fit", *SHORT, *fixed])
    folder = Path("logs/lightning_logs/mine")
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    main(["fit", *SHORT, *fixed, "--seed_everything=1"])
    assert {path: path.read_bytes() for path in before} == before
    added = {"config-v1.yaml", "summary-v1.json", "checkpoints/last-v1.ckpt"}
    assert all((folder / name).exists() for name in added)


def test_curves_of_another_run_are_not_deleted(capsys):
    fixed = ["--trainer.logger=CSVLogger", "--trainer.logger.save_dir=logs"]
    fixed += ["--trainer.logger.version=7"]
    main(["fit", *SHORT, *fixed])
    curves = Path("logs/lightning_logs/version_7/metrics.csv")
    before = curves.read_bytes()
    with pytest.raises(SystemExit) as end:
        main(["fit", *SHORT, *fixed])
    assert end.value.code == 2
    assert f"error: CSVLogger would delete {curves}" in capsys.readouterr().err
    assert curves.read_bytes() == before


def test_runs_that_start_together_get_folders_of_their_own():
    context = multiprocessing.get_context("fork")  # which has imported already
    barrier, found = context.Barrier(2), context.Queue()
    claim = partial(context.Process, target=claim_many, args=(barrier, found), daemon=True)
    runs = [claim(), claim()]
    for run in runs:
        run.start()
    folders = [folder for _ in runs for folder in found.get(timeout=60)]
    for run in runs:
        run.join(60)
    assert [run.exitcode for run in runs] == [0, 0]
    assert len(folders) == len({*folders}) == 100


def claim_many(barrier, found):
    barrier.wait(60)
    found.put([claim_folders([TensorBoardLogger(".")])[0] for _ in range(50)])


def test_loggers_of_one_name_share_the_folder():
    for version in range(2):
        loggers = [TensorBoardLogger("."), CSVLogger("."), CSVLogger(".", "other")]
        folders = [Path("lightning_logs"), Path("lightning_logs"), Path("other")]
        assert claim_folders(loggers) == [f / f"version_{version}" for f in folders]


def test_a_run_may_write_its_own_file_twice(tmp_path):
    task = PredatorPrey()
    trainer = pl.Trainer(
        default_root_dir=tmp_path,
        logger=False,
        max_epochs=1,
        callbacks=[RunSummary()],
        enable_progress_bar=False,
        enable_checkpointing=False,
    )
    trainer.fit(Agent(task, seed=0), RolloutDataModule(task, 4, updates_per_epoch=2))
    trainer.fit_loop.max_epochs = 2
    trainer.fit(trainer.lightning_module, trainer.datamodule)
    assert [p.name for p in run_folder(trainer).path.iterdir()] == ["summary.json"]


def test_a_new_file_has_a_name_of_its_own(tmp_path):
    names = [new_file(tmp_path, "table.csv").name for _ in range(3)]
    assert names == ["table.csv", "table-v1.csv", "table-v2.csv"]
