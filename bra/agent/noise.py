"""What Lightning says that is no news to anybody who trains agents."""

import logging
import re
import warnings

import lightning.pytorch as pl
from lightning.pytorch.callbacks import ModelSummary

WARNINGS = (
    ".*does not have many workers",
    ".*log_every_n_steps",
    ".*smaller than the logging interval",
    "The dirpath has changed from",
    "Using ModelCheckpoint with manual optimization",  # after the update is what we want
    ".*isinstance.treespec, LeafSpec",
    ".*sync_dist=True",  # every rank evaluates the same agent
    ".*args parameter is intended to run from within Python",
    ".*Experiment logs directory .* exists and is not empty",  # see bra.agent.run_folder
)
LINES = re.compile("(GPU|TPU|HPU) available|💡 Tip|`Trainer.fit` stopped: `max_epochs")


def leave_out_noise() -> None:
    """Keeps hardware lists, tips and worker counts from being printed; all else is."""
    for message in WARNINGS:
        warnings.filterwarnings("ignore", message)
    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(f"{name}.utilities.rank_zero").addFilter(_is_news)


def leave_out_summary(trainer: pl.Trainer) -> None:
    """No table of parameters unless somebody asks for a deeper one; `print(agent)` says more."""
    callbacks: list[pl.Callback] = trainer.callbacks  # type: ignore[attr-defined]  # set by a connector
    for callback in callbacks:
        if type(callback) is ModelSummary and callback._max_depth == 1:
            callback._max_depth = 0


def _is_news(record: logging.LogRecord) -> bool:
    return not LINES.match(record.getMessage())
