"""What the command does with a model: Lightning's verbs and ours."""

from typing import Any

import lightning.pytorch as pl

from bra.agent import Learner
from bra.callbacks.baseline import BaselineMonitor, baseline_of
from bra.cli.baseline import report
from bra.cli.frontier import run_frontier
from bra.tasks import RolloutDataModule


class Trainer(pl.Trainer):
    """Lightning's trainer, and what can be done without training."""

    def test(self, *, verbose: bool = False, **kwargs: Any) -> Any:  # type: ignore[override]  # by keys
        """Tests; our table has what Lightning's would repeat.

        Args:
            verbose: Whether Lightning's table follows.
            kwargs: As Lightning has them.
        """
        return super().test(verbose=verbose, **kwargs)

    def baseline(
        self,
        model: Learner,
        datamodule: RolloutDataModule | None = None,
        json: bool = False,
        certify: float | None = None,
    ) -> None:
        """Solves for the Blahut-Arimoto optimum and prints it, without training.

        As the run's monitor of the optimum does, with its restarts.

        Args:
            model: States the problem, at one pair of prices or at lists of them.
            datamodule: Not used.
            json: Whether to print JSON, with information in nats, instead of a table.
            certify: Seconds to spend on a smaller bound; None is what the monitor spends.
        """
        monitor = baseline_of(self) or BaselineMonitor()
        seconds = monitor.certify if certify is None else certify
        print(report(model, json, monitor.restarts, seconds))

    def frontier(
        self,
        model: Learner,
        datamodule: RolloutDataModule | None = None,
        points: int = 40,
        grid: bool = False,
        agents: bool = False,
    ) -> None:
        """Solves along prices, and writes `frontier.csv`, `frontier.png` and `frontier.pdf`.

        With as many restarts as the run's monitor of the optimum.

        Args:
            model: States the problem; its prices are scaled together.
            datamodule: Draws the worlds that agents are trained on.
            points: Pairs of prices.
            grid: Whether both prices vary by themselves, over points × points pairs.
            agents: Whether agents are trained at these prices and drawn beside the optimum.
        """
        run_frontier(self, model, datamodule, points, grid, agents)
