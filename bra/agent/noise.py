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
LINES = re.compile(
    "(GPU|TPU|HPU) available|💡 Tip|`Trainer.fit` stopped: `max_|LOCAL_RANK: |Using .+ Automatic"
    r"|(\[rank: \d+\] )?Seed set|Restor(ing|ed all) states|Loaded model weights|Detected Keyboard"
    r"|SLURM auto-requeueing|(\[rank: \d+\] )?(Received|Bypassing) SIGTERM|Loading `train_data"
    "|Initializing distributed|-{99}"
)
LOGGERS = (
    "lightning.pytorch.utilities.rank_zero",
    "lightning.pytorch.accelerators.cuda",
    "lightning.pytorch.trainer.connectors.signal_connector",
    "lightning.fabric.utilities.rank_zero",
    "lightning.fabric.utilities.distributed",
    "lightning.fabric.utilities.seed",
)


def leave_out_noise() -> None:
    """Keeps hardware lists, tips and worker counts from being printed; all else is."""
    for message in WARNINGS:
        warnings.filterwarnings("ignore", message)
    for name in LOGGERS:
        logging.getLogger(name).addFilter(_is_news)


def leave_out_summary(trainer: pl.Trainer) -> None:
    """No table of parameters unless somebody asks for a deeper one; `print(agent)` says more.

    Trainers of other classes, such as the command's, may have none by default.
    """
    if type(trainer) is not pl.Trainer:
        return
    callbacks: list[pl.Callback] = trainer.callbacks  # type: ignore[attr-defined]  # set by a connector
    for callback in callbacks:
        if type(callback) is ModelSummary and callback._max_depth == 1:
            callback._max_depth = 0


def _is_news(record: logging.LogRecord) -> bool:
    return not LINES.match(record.getMessage())
