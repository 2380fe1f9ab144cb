"""Where a run writes, and what it never writes over."""

from collections.abc import Sequence
from pathlib import Path
from weakref import WeakKeyDictionary

import lightning.pytorch as pl
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger

from bra.checkpoints.files import read_checkpoint

FolderLogger = TensorBoardLogger | CSVLogger


class RunFolder:
    """A folder, and the files that one run has created in it.

    Args:
        path: An existing folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._files: dict[str, Path] = {}

    def file(self, name: str) -> Path:
        """A file of this run: the same for the same name, and none that was there before."""
        if name not in self._files:
            self._files[name] = new_file(self.path, name)
        return self._files[name]


_RUNS: WeakKeyDictionary[pl.Trainer, RunFolder] = WeakKeyDictionary()


def run_folder(trainer: pl.Trainer) -> RunFolder:
    """The folder of the trainer's run, claimed when it is first asked for.

    It is that of the first logger that has one, else a new one below the trainer's root. To be
    asked by the process that writes, of rank 0.

    Raises:
        OSError: If a folder cannot be made, or holds curves that a logger would delete.
    """
    if trainer not in _RUNS:
        roots = [logger.save_dir for logger in trainer.loggers]
        new = CSVLogger(next(filter(None, roots), trainer.default_root_dir))
        _RUNS[trainer] = RunFolder(claim_folders(folder_loggers(trainer) or [new])[0])
    return _RUNS[trainer]


def folder_loggers(trainer: pl.Trainer) -> list[FolderLogger]:
    """The loggers that write into a folder of the run."""
    return [logger for logger in trainer.loggers if isinstance(logger, FolderLogger)]


def last_checkpoint(trainer: pl.Trainer) -> Path:
    """The newest `last.ckpt` of the runs whose folders lie where the trainer's will.

    Raises:
        FileNotFoundError: If there is none.
    """
    logger = next(iter(folder_loggers(trainer)), CSVLogger(trainer.default_root_dir))
    roots = [logger.root_dir, *(own.dirpath for own in trainer.checkpoint_callbacks)]  # type: ignore[attr-defined]  # some have one
    found = [path for root in filter(None, roots) for path in Path(root).rglob("last*.ckpt")]
    if not found:
        raise FileNotFoundError(f"there is no last.ckpt below {logger.root_dir}; name a file")
    return max(found, key=lambda path: path.stat().st_mtime)


def best_checkpoint(trainer: pl.Trainer) -> Path:
    """The best of that run, by what its checkpoints were to monitor, or else its newest.

    Raises:
        FileNotFoundError: If there is none.
    """
    last = last_checkpoint(trainer)
    states = read_checkpoint(last, "cpu")["callbacks"].values()
    names = [Path(path).name for state in states if (path := state.get("best_model_path"))]
    best = next((last.with_name(name) for name in names if last.with_name(name).exists()), None)
    if best is None:
        raise FileNotFoundError(f"the run of {last} has no best checkpoint; take ckpt_path last")
    return best


def claim_folders(loggers: Sequence[FolderLogger]) -> list[Path]:
    """Makes each logger's folder; no other run that starts at the same moment gets the same.

    Loggers of the same name share one. A logger that was told its version keeps it.
    """
    starts = [logger._get_next_version() for logger in loggers]
    claimed: list[Path] = []
    for logger, start in zip(loggers, starts, strict=True):
        claimed.append(_claim(logger, start, claimed))
    return claimed


def _claim(logger: FolderLogger, version: int, shared: Sequence[Path]) -> Path:
    if logger._version is not None:
        return _told(logger)
    while True:
        logger._version = version
        folder = Path(logger.log_dir)
        if folder in shared:
            return folder
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir()
            return folder
        except FileExistsError:
            if not folder.parent.is_dir():
                raise _no_folder(folder, "a link or file is in its place") from None
            version += 1
        except OSError as error:
            raise _no_folder(folder, error.strerror) from error


def _no_folder(folder: Path, reason: str | None) -> OSError:
    return OSError(
        f"cannot make the run's folder {folder}: {reason}; choose another trainer.default_root_dir"
    )


def _told(logger: FolderLogger) -> Path:
    folder = Path(logger.log_dir)
    folder.mkdir(parents=True, exist_ok=True)
    curves = folder / "metrics.csv"
    if isinstance(logger, CSVLogger) and curves.exists():
        raise FileExistsError(
            f"CSVLogger would delete {curves}, which is of another run; give it another version, "
            "or none"
        )
    return folder


def new_file(folder: Path, name: str) -> Path:
    """Creates an empty file: `name`, or if that is there already, with -v1, -v2, … in its stem."""
    path, number = folder / name, 0
    while True:
        try:
            path.touch(exist_ok=False)
            return path
        except FileExistsError:
            number += 1
            path = path.with_stem(f"{Path(name).stem}-v{number}")
