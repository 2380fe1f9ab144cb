"""What a checkpoint holds of an agent, and what goes on from it."""

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Self, cast

import lightning.pytorch as pl
from lightning.pytorch.trainer.states import TrainerFn
from torch import Tensor

from bra.checkpoints import Rebuildable
from bra.checkpoints import files as checkpoints
from bra.checkpoints.recipes import Recipe, from_recipe
from bra.checkpoints.training import check_training_state
from bra.checks.failures import find_note, own_traceback
from bra.checks.settings import DEFAULT_RUN

CHANNELS = ("perception.", "action.")
"""How the names of what a trained agent acts by begin,"""
BUDGETS = "budgets."
"""and those of how far prices have moved, which may be others than those of a checkpoint."""


class Resumable(Rebuildable, pl.LightningModule, ABC):
    """Counts its updates, and is rebuilt from a checkpoint alone.

    Attributes:
        seed: Of all that updates draw.
        recipe: What a checkpoint rebuilds this module from.
        updates: Updates made so far; part of every checkpoint.
        samples: World-states drawn so far; part of every checkpoint.
        run: Updates of the run that shares of a run are of: the first one, however long others are
            that go on from it; None before it. Part of every checkpoint.
    """

    seed: int
    recipe: dict[str, Recipe]

    def __init__(self) -> None:
        super().__init__()
        self.updates = 0
        self.samples = 0
        self.run: int | None = None

    def settle(self) -> None:
        """Turns shares of the run, of cooling say, into updates, now that its length is known."""
        self.run = self.run or _run_length(self.trainer)
        self._settle(self.run)

    @abstractmethod
    def _settle(self, run: int) -> None:
        """The same for a run of so many updates."""

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Adds counters and the recipe."""
        batches = self.trainer.num_training_batches
        if "loops" in checkpoint and batches < math.inf:
            checkpoints.settle_epochs(checkpoint["loops"]["fit_loop"], int(batches))
        checkpoint[checkpoints.KEY] = {
            "updates": self.updates,
            "samples": self.samples,
            "run": self.run,
            "recipe": self.recipe,
        }

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Takes over counters and seed.

        What does not train, test say, looks at the channels alone.

        Raises:
            CheckpointError: If the checkpoint is of another task, other channels or another number
                of agents; or what trains the agent is another, or its state no state to go on from.
        """
        saved, own = checkpoint[checkpoints.KEY], self.state_dict()
        checkpoints.check_same_parts(saved["recipe"], self.recipe)
        self._take_counts(saved)
        if self._trainer is None or self._trainer.state.fn != TrainerFn.FITTING:
            saved_state = checkpoint["state_dict"]
            channels = {n: t for n, t in saved_state.items() if n.startswith(CHANNELS)}
            like = {n for n, t in saved_state.items() if n in own and t.shape == own[n].shape}
            checkpoint["state_dict"] = own | {n: saved_state[n] for n in like} | channels
        else:
            if self.run:
                self._settle(self.run)
            parts = checkpoints.TRAINED_BY
            checkpoints.check_same_parts(saved["recipe"], self.recipe, parts)
            optimizers, schedulers = cast(Any, self.configure_optimizers())
            loop = self.trainer.fit_loop.state_dict()
            check_training_state(checkpoint, optimizers, schedulers, loop)
            seed = saved["recipe"]["seed"]
            if seed != self.seed and self.trainer.is_global_zero:
                print(f"note: goes on with seed {seed} of its checkpoint, in place of {self.seed}")
            checkpoint["state_dict"] = self._at_own_prices(checkpoint["state_dict"])
        checkpoints.check_state(checkpoint["state_dict"], own)
        self.seed = self.recipe["seed"] = saved["recipe"]["seed"]

    @classmethod
    def load_from_checkpoint(  # type: ignore[override]  # Lightning's options do not apply
        cls,
        checkpoint_path: str | os.PathLike[str],
        map_location: Any = None,
        trusted: str | Sequence[str] = (),
        **overrides: Any,
    ) -> Self:
        """Rebuilds what a checkpoint holds, with `weights_only=True`.

        An `Agent` of a population's checkpoint is the best of its members.

        Args:
            checkpoint_path: Path of the checkpoint.
            map_location: As for `torch.load`.
            trusted: Modules of one's own that may be imported for the classes that the checkpoint
                names, such as `"my_channels"`, or several. Those of `bra`, and what is loaded
                already, need no mention.
            overrides: Arguments of the class to take instead of the saved ones, such as other
                prices, or a task or channel whose class cannot be imported here.

        Raises:
            ValueError: If the file is no checkpoint of an agent, or names a class that cannot be
                imported, may not be, or has no place in an agent.
        """
        checkpoint = cls._unpack(checkpoints.read_checkpoint(checkpoint_path, map_location))
        saved = checkpoint[checkpoints.KEY]
        kept = {part: recipe for part, recipe in saved["recipe"].items() if part not in overrides}
        try:
            learner = cls(**from_recipe(kept, trusted), **overrides)
        except TypeError as error:
            if find_note(error) or own_traceback(error):
                raise
            raise ValueError(f"{checkpoint_path} holds no {cls.__name__}: {error}") from error
        learner.load_state_dict(learner._at_own_prices(checkpoint["state_dict"]))
        learner._take_counts(saved)
        return learner

    def _at_own_prices(self, state: dict[str, Tensor]) -> dict[str, Tensor]:
        """A state in which prices follow a budget if this agent has one."""
        own = self.state_dict()
        led = {name: tensor for name, tensor in own.items() if name.startswith(BUDGETS)}
        return led | {n: t for n, t in state.items() if n in led or not n.startswith(BUDGETS)}

    def _take_counts(self, saved: dict[str, Any]) -> None:
        self.updates, self.samples, self.run = saved["updates"], saved["samples"], saved.get("run")

    @classmethod
    def _unpack(cls, checkpoint: dict[str, Any]) -> dict[str, Any]:
        """The part of a checkpoint that this class is rebuilt from."""
        return checkpoint


def _run_length(trainer: pl.Trainer) -> int:
    """Updates that a trainer is to make, counted from the first of all."""
    trainer.fit_loop.setup_data()
    updates = trainer.estimated_stepping_batches
    return int(updates) if 0 < updates < math.inf else DEFAULT_RUN
