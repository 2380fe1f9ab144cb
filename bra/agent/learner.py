"""What trains by updates, and judges itself: an agent, or a population."""

import itertools
import os
from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from textwrap import indent
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar, cast

import lightning.pytorch as pl
import torch
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.trainer.states import TrainerFn
from torch import Tensor

from bra.agent.optimizers import at_rest, check_lengths
from bra.agent.run_folder import folder_loggers, run_folder
from bra.agent.trained import Trained
from bra.agent.trainers import Naming, check_worlds, prepare
from bra.checks.words import amount
from bra.cooling import Cooling
from bra.evaluation import Evaluation
from bra.objective import Objective, logged
from bra.tasks import World

if TYPE_CHECKING:
    from bra.agent.agent import Agent

Found = TypeVar("Found")

MOST_LOST = 0.02
"""Share of χ²(ξ;X) by which updates may find I(ξ;X) too small without a word."""


class Learner(Trained):
    """Trains, and tells how far it is; `trainer.global_step` counts updates.

    Attributes:
        beta_direct: β₃ of every agent, or None.
        cooling: How prices approach the agents' own, or None.
    """

    beta_direct: float | None
    cooling: Cooling | None

    def __init__(self) -> None:
        super().__init__()
        self._found: tuple[Any, Any] | None = None

    def __repr__(self) -> str:
        """Task, channels, rule, prices, and how far training has come."""
        first, others = self.settings[0], len(self.settings) - 1
        lines = (
            f"task: {self.task}",
            f"perception p(x|ξ): {self.perception}",
            f"action p(a|x): {self.action}",
            f"update rule: {self.update_rule}",
            f"β₁ {first.beta_perception:g}, β₂ {first.beta_action:g}, seed {first.seed}"
            + (f", and {amount(others, 'other agent')}" if others else ""),
            amount(self.updates, "update"),
        )
        text = indent("\n".join(lines), "  ")
        return f"{type(self).__name__}(\n{text}\n)"

    def configure_callbacks(self) -> list[pl.Callback]:
        """One that names errors; and the first hook of a run, to look at the trainer's options.

        Lightning refuses to clip what is optimised by hand, so that it must not see the limit until
        `setup`.

        Raises:
            ValueError: If the agent cannot follow them.
        """
        prepare(self.trainer)
        self._limit, self.trainer.gradient_clip_val = self.trainer.gradient_clip_val, None
        there = any(isinstance(callback, Naming) for callback in self.trainer.callbacks)  # type: ignore[attr-defined]
        return [] if there else [Naming()]

    def setup(self, stage: str) -> None:
        """Gives the trainer its limit of gradients back."""
        self.trainer.gradient_clip_val = self._limit

    def prepare_data(self) -> None:
        """Claims the folder of the run, before loggers look for one."""
        if self.trainer.is_global_zero and folder_loggers(self.trainer):
            run_folder(self.trainer)

    def _wait_for_cooling(self) -> None:
        """Lets budgets lead prices from the end of cooling on."""
        if self.budgets:
            self.budgets.begins.fill_(self.cooling.length if self.cooling else 0)

    @property
    @abstractmethod
    def chosen(self) -> str:
        """A line that says which parts were chosen from the task; empty if none were."""

    def _beware(self) -> str:
        """A line if batches are so small that updates find information too cheap; else empty."""
        count = getattr(getattr(self.trainer, "datamodule", None), "batch_size", None)
        lost = self.marginals.information_lost(count) if count and self._uses_worlds() else 0.0
        if lost <= MOST_LOST:
            return ""
        return (
            f"note: with batches of {count} {type(self.marginals).__name__} find I(ξ;X) too small "
            f"by {lost:.2g} times χ²(ξ;X) ≤ |X| − 1 nats; take larger batches or a higher decay"
        )

    @abstractmethod
    def _uses_worlds(self) -> bool:
        """Whether the rule looks at batches of worlds."""

    def on_fit_start(self) -> None:
        """Looks at the task of the worlds, and says what was chosen."""
        check_worlds(self.trainer, self.task)
        self.settle()
        check_lengths(self._schedulers(), self.run or 0)
        self.prepare_blocks()
        if self.trainer.is_global_zero:
            notes = (self.chosen, self._beware(), *at_rest(self.trainer.optimizers))
            for line in filter(None, notes):
                print(line)
        if not torch.cuda.is_available():
            # Adam asks for GPUs in every step, and Lightning has torch ask by a way that takes
            # longer than the step does, so that forked processes can use them. There is none.
            os.environ["PYTORCH_NVML_BASED_CUDA_CHECK"] = "0"

    @abstractmethod
    def best_agent(self) -> "Agent":
        """The best agent: to be read and not to be trained."""

    @abstractmethod
    def evaluate_members(self) -> Objective[Tensor]:
        """J and its terms of every agent, (R,) each, float64."""

    def objectives(self) -> Tensor:
        """J of every agent, (R,), float64."""
        return self.evaluate_members().objective

    @abstractmethod
    def evaluation(self, world: World | None = None) -> Evaluation:
        """J of the best agent, its terms, and its channels as tables."""

    def evaluate(self) -> Objective[float]:
        """J and its terms: exact for discrete percepts of a noiseless sensor, else estimated.

        See `bra.evaluation.evaluate` for the estimates and their bias.
        """
        return self.evaluation().objective

    def _once(self, work_out: Callable[[], Found]) -> Found:
        """What is worked out anew only when channels or prices have changed."""
        channels = (self.perception, self.action)
        tensors = [t for c in channels for t in itertools.chain(c.parameters(), c.buffers())]
        if any(tensor.is_inference() for tensor in tensors):  # which tell of no changes
            return work_out()
        state = (self.updates, self.settings, *((t.data_ptr(), t._version) for t in tensors))
        if self._found is None or self._found[0] != state:
            self._found = (state, work_out())
        return cast(Found, self._found[1])

    @contextmanager
    def _evaluating(self) -> Iterator[None]:
        """Within, channels are in evaluation mode."""
        training = self.training
        self.eval()
        try:
            yield
        finally:
            self.train(training)

    def train_dataloader(self) -> NoReturn:
        """Asked for only where nothing else has worlds.

        Raises:
            MisconfigurationException: Always.
        """
        raise MisconfigurationException(
            "there are no worlds to learn from; call trainer.fit(agent, RolloutDataModule(task))"
        )

    def validation_step(self, world: World, batch_idx: int) -> None:
        """Logs J and its terms."""
        self._log_evaluation(world)

    def test_step(self, world: World, batch_idx: int) -> None:
        """Logs J and its terms."""
        self._log_evaluation(world)

    def on_validation_start(self) -> None:
        """Lets Lightning log at the agent's update: it counts what this trainer has made alone."""
        self.trainer.fit_loop.epoch_loop._batches_that_stepped = self.updates

    on_test_start = on_validation_start

    def _log_evaluation(self, world: World) -> None:
        # During fit, the information monitor writes the curves; here only callbacks listen.
        self.log_dict(
            logged(self.evaluation(world).objective),
            logger=self.trainer.state.fn != TrainerFn.FITTING,
            batch_size=1,
        )
