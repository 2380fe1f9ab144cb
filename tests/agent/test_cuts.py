"""Runs that are cut anywhere, and cut again, end as if nothing had happened."""

from functools import partial

import pytest
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from training import assert_same_state, make_trainer

from bra import Agent, Cooling, Population, PredatorPrey, RolloutDataModule
from bra.channels import MLP, Multinomial
from bra.critics import Exploration, NetworkCritic
from bra.update_rules import ExactGradient, Projection, Rivals, ScoreFunction

EPOCHS, PER_EPOCH = 3, 3
ALL = EPOCHS * PER_EPOCH
TASK = PredatorPrey()
TABLES = {"perception": MLP, "action": Multinomial, "percepts": 3, "seed": 0}
SCORE = ScoreFunction(2, "running")
KINDS = {
    "score": partial(Agent, TASK, update_rule=SCORE, cooling=Cooling(updates=5), **TABLES),
    "gradient": partial(Agent, TASK, update_rule=ExactGradient(), **TABLES),
    "projection": partial(Agent, TASK, update_rule=Projection(rivals=Rivals()), **TABLES),
    "critic": partial(
        Agent,
        TASK,
        update_rule=Projection(critic=NetworkCritic(), exploration=Exploration()),
        **TABLES,
    ),
    "population": partial(Population, TASK, 2, update_rule=SCORE, **TABLES),
}


def train(make, folder, ckpt_path=None, **limits):
    """Trains, with a checkpoint after every update and epoch."""
    learner = make()
    after_updates = ModelCheckpoint(folder, "{step}", save_top_k=-1, every_n_train_steps=1)
    after_epochs = ModelCheckpoint(folder, "epoch-{step}", save_top_k=-1)
    trainer = make_trainer(
        folder,
        callbacks=[after_updates, after_epochs],
        enable_checkpointing=True,
        limit_val_batches=0,
        **({"max_epochs": EPOCHS} | limits),
    )
    data = RolloutDataModule(learner.task, 4, PER_EPOCH)
    trainer.fit(learner, data, ckpt_path=ckpt_path, weights_only=True)
    return learner, trainer


def end_of(folder):
    return torch.load(folder / f"step={ALL}.ckpt", weights_only=True)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "cuts",
    [
        [(3, 4), (2, 6), (6, 7)],
        pytest.param(
            [(i, j) for i in range(1, ALL) for j in range(i + 1, ALL)], marks=pytest.mark.slow
        ),
    ],
    ids=["some", "all"],
)
def test_a_run_cut_twice_is_as_long_as_one_that_ran_through(tmp_path, kind, cuts):
    whole, trainer = train(KINDS[kind], tmp_path)
    assert (whole.updates, trainer.current_epoch) == (ALL, EPOCHS)
    through = end_of(tmp_path)
    for first in {i for i, _ in cuts}:
        once = tmp_path / f"from {first}"
        again, _ = train(KINDS[kind], once, tmp_path / f"step={first}.ckpt")
        assert_same_state(again, whole)
        for second in (j for i, j in cuts if i == first):
            folder = once / f"from {second}"
            again, trainer = train(KINDS[kind], folder, once / f"step={second}.ckpt")
            assert_same_state(again, whole)
            assert trainer.current_epoch == EPOCHS
            ended = end_of(folder)
            assert ended["epoch"] == through["epoch"]
            assert ended["loops"]["fit_loop"] == through["loops"]["fit_loop"]


@pytest.mark.parametrize("limits", [{"max_epochs": EPOCHS}, {"max_epochs": -1, "max_steps": ALL}])
def test_ends_of_epochs_are_places_to_go_on_from(tmp_path, limits):
    whole, trainer = train(KINDS["score"], tmp_path, **limits)
    epoch = trainer.current_epoch
    for cut in (3, 6):
        folder = tmp_path / f"from {cut}"
        again, trainer = train(
            KINDS["score"], folder, tmp_path / f"epoch-step={cut}.ckpt", **limits
        )
        assert_same_state(again, whole)
        assert trainer.current_epoch == epoch


def test_a_run_goes_on_with_more_epochs(tmp_path):
    whole, _ = train(KINDS["score"], tmp_path)
    train(KINDS["score"], tmp_path / "short", max_epochs=1)
    again, _ = train(KINDS["score"], tmp_path / "long", tmp_path / "short/step=3.ckpt")
    assert_same_state(again, whole)
