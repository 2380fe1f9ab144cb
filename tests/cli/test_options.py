"""Options of trainer and optimizers that an agent cannot follow, and what was to be printed."""

import re
from pathlib import Path

import pytest

from bra import Agent
from bra.cli import main

FIT = [
    *("fit", "--data.task=PredatorPrey", "--trainer.max_epochs=1", "--data.updates_per_epoch=4"),
    *("--trainer.enable_progress_bar=false", "--behaviour=null", "--baseline=null"),
    *("--trainer.logger=CSVLogger", "--trainer.logger.save_dir=."),
]
ADAM = "--model.perception_optimizer=Adam"
ONE_CYCLE = ["--model.action_scheduler=OneCycleLR", "--model.action_scheduler.max_lr=0.1"]


def callback(name, **arguments):
    words = [f"--trainer.callbacks.{key}={value}" for key, value in arguments.items()]
    return [f"--trainer.callbacks+={name}", *words]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--trainer.overfit_batches=2"], "overfit_batches must be 0, got 2: every batch is drawn"),
        (["--trainer.val_check_interval=0"], "trainer.val_check_interval must be positive, got 0"),
        (["--trainer.val_check_interval=9"], "`val_check_interval` (9) must be less than or equal"),
        (["--trainer.check_val_every_n_epoch=0"], "must be null or at least 1, got 0; trainer.lim"),
        (["--trainer.gradient_clip_val=-1"], "gradient_clip_val must be at least 0, got -1.0"),
        (["--trainer.gradient_clip_val=.nan"], "gradient_clip_val must be at least 0, got nan"),
        (["--trainer.log_every_n_steps=-1"], "log_every_n_steps must be at least 0, got -1"),
        (["--trainer.min_epochs=-1"], "trainer.min_epochs must be at least 0, got -1"),
        (["--trainer.min_steps=-2"], "trainer.min_steps must be at least 0, got -2"),
        (["--model.seed=3"], "model.seed is set by seed_everything; give --seed_everything a nu"),
        (callback("LearningRateFinder"), "LearningRateFinder works where Lightning has one loss"),
        (
            callback("GradientAccumulationScheduler", scheduling="{0: 2}"),
            "GradientAccumulationScheduler works where",
        ),
        (
            callback("EarlyStopping", monitor="nowhere"),
            "metric `nowhere` which is not available. Pass in or modify your `EarlyStopping` callb",
        ),
        (["--model.action_optimizer=SparseAdam"], "action_optimizer: SparseAdam takes sparse grad"),
        (
            [ADAM, *(f"--model.perception_optimizer.{way}=true" for way in ("fused", "foreach"))],
            "perception_optimizer: `fused` and `foreach` cannot be `True` together",
        ),
        ([ADAM, "--model.perception_optimizer.capturable=true"], "AssertionError: If capturable"),
        ([*ONE_CYCLE, "--model.action_scheduler.total_steps=3"], "OneCycleLR ends after total_ste"),
        (
            ["--model.action_scheduler=ExponentialLR", "--model.action_scheduler.gamma=1e30"],
            "ExponentialLR leads to a learning rate of 3e+59 in update 2; choose a milder schedule",
        ),
        (["--model.percepts=1000000000000000000000000000000"], "int too large to convert"),
    ],
)
def test_what_an_agent_cannot_follow_is_one_line(capsys, words, said):
    with pytest.raises(SystemExit) as end:
        main([*FIT, *words])
    line = capsys.readouterr().err.splitlines()[-1]
    assert end.value.code == 2
    assert line.startswith("error: ") and said in line


def test_what_was_asked_for_is_printed(capfd, caplog):
    caplog.set_level("INFO")
    words = ["--trainer.enable_model_summary=true", "--trainer.profiler=simple"]
    early = callback("EarlyStopping", monitor="objective/J", verbose="true")
    main([*FIT, *words, *early, *ONE_CYCLE, "--model.action_scheduler.total_steps=4"])
    said = "".join([*capfd.readouterr(), caplog.text])
    for text in ("Total params", "Metric objective/J improved", "Profiler Report"):
        assert text in said
    for text in ("GPU available", "Seed set", "`Trainer.fit` stopped", "Tip: "):
        assert text not in said


def test_a_single_callback_needs_no_list():
    main(
        [*FIT, "--trainer.callbacks={class_path: EarlyStopping, init_args: {monitor: objective/J}}"]
    )
    assert Path("lightning_logs/version_0/checkpoints/last.ckpt").exists()


def test_a_barebones_trainer_trains(capsys):
    main([*FIT[:4], "--trainer.barebones=true"])
    (file,) = (path for path in Path().rglob("*") if path.is_file())
    assert file.name == "config.yaml"
    assert "chosen for this task" in capsys.readouterr().out


def test_a_run_goes_on_with_the_seed_of_its_checkpoint(capsys):
    main([*FIT, "--seed_everything=3"])
    main([*FIT, "--trainer.max_epochs=2", "--ckpt_path=last"])
    assert "note: goes on with seed 3 of its checkpoint, in place of 0" in capsys.readouterr().out
    assert "seed_everything: 3" in Path("lightning_logs/version_1/config.yaml").read_text()


@pytest.mark.parametrize("logger", ["CSVLogger", "TensorBoardLogger"])
def test_a_folder_that_vanishes_is_one_line(capsys, logger):
    words = [f"--trainer.logger={logger}", "--trainer.logger.save_dir=."]
    taken = ["--trainer.enable_checkpointing=false", *callback("stopping.TakeFolder")]
    with pytest.raises(SystemExit) as end:
        main([*FIT, *words, *taken])
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert re.match(r"error: there is no .*version_0.* deleted", said.splitlines()[-1])


def test_a_checkpoint_makes_its_folder_anew():
    main([*FIT, *callback("stopping.TakeFolder")])
    assert Agent.load_from_checkpoint("lightning_logs/version_0/checkpoints/last.ckpt").updates == 4
