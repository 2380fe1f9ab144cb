"""Rows that are added to a table while a run lasts, and that a resumed run goes on with."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import lightning.pytorch as pl

from bra.agent.run_folder import run_folder

CURVES = "curves.csv"


def append_rows(trainer: pl.Trainer, rows: Sequence[Mapping[str, Any]]) -> None:
    """Adds the rows of one look to `curves.csv` in the run's folder, all of them or none.

    The first ones follow those of the run that is resumed, up to the checkpoint. Each row begins
    with the number of updates.
    """
    path = run_folder(trainer).file(CURVES)
    header = ",".join(rows[0])
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(row.values() for row in rows)
    begun = "" if path.stat().st_size else _begun(trainer, header, rows[0]["updates"])
    with path.open("ab", buffering=0) as file:
        file.write(f"{begun}{text.getvalue()}".encode())


def _begun(trainer: pl.Trainer, header: str, updates: int) -> str:
    """The header, and what the run that is resumed had before so many updates."""
    lines = [header]
    if trainer.ckpt_path:
        folder = Path(trainer.ckpt_path).resolve().parent
        folder = folder.parent if folder.name == "checkpoints" else folder
        earlier = folder / CURVES
        known = earlier.read_text(encoding="utf-8").splitlines() if earlier.exists() else []
        if known[:1] == [header]:
            lines += [row for row in known[1:] if int(row.partition(",")[0]) < updates]
    return "".join(f"{line}\n" for line in lines)
