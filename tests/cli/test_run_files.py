"""What runs write, and that they never write over what is not theirs."""

import subprocess
import sys
from pathlib import Path

import lightning.pytorch as pl
import pytest
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger

from bra import Agent, RolloutDataModule
from bra.agent.run_folder import claim_folders, new_file, run_folder
from bra.callbacks import RunSummary
from bra.cli import main
from bra.tasks import PredatorPrey

CONFIG = f"--config={Path(__file__).parents[2] / 'configs/predator_prey.yaml'}"
QUICK = ["--trainer.max_epochs=1", "--data.updates_per_epoch=4", "--data.evaluation_worlds=4"]
QUIET = ["--trainer.enable_progress_bar=false", "--behaviour=null", "--baseline=null"]
SHORT = [CONFIG, *QUICK, *QUIET]
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
    code = (
        "from bra.agent.run_folder import claim_folders\n"
        "from lightning.pytorch.loggers import TensorBoardLogger\n"
        "input()\n"
        "for _ in range(50): print(*claim_folders([TensorBoardLogger('.')]))\n"
    )
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)
    ]
    found = [run.communicate("\n", timeout=120)[0].split() for run in runs]
    assert [run.returncode for run in runs] == [0, 0]
    assert len({*found[0], *found[1]}) == 100


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
