"""What an agent adds to Lightning's checkpoints, and reads from them."""

import hashlib
import io
import math
import os
import pickle
import zipfile
import zlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from bra.checkpoints.recipes import (
    Recipe,
    describe_recipe,
    is_recipe,
    same_recipe,
    with_defaults,
)
from bra.checks.words import shown

KEY = "bra"
VARIED = (
    *("beta_perception", "beta_action", "perception_rate", "action_rate"),
    *("perception_bits", "action_bits"),
)
"""What agents of a population may differ in, besides their seeds."""
FIXED_PARTS = ("task", "percepts", "perception", "action")
"""Parts of an agent that a checkpoint must share with the agent that it is for."""
TRAINED_BY = (
    "update_rule",
    "marginals",
    *(f"{name}_{kind}" for kind in ("optimizer", "scheduler", "rate") for name in FIXED_PARTS[2:]),
)
"""Parts whose state a training goes on with; prices and cooling may be others."""


MARK = b"\x24\0bra:"
"""How the end of a checkpoint begins: the length of a zip file's comment, and this comment."""
SEAL = 2 + 0x24
"""Bytes of this end."""
VERSION = "pytorch-lightning_version"


class CheckpointError(ValueError):
    """A checkpoint that does not serve, for a reason that one line can tell."""


def read_checkpoint(path: str | os.PathLike[str], map_location: Any = None) -> dict[str, Any]:
    """Reads a checkpoint of an agent, plain data and tensors only.

    Raises:
        OSError: If there is no such file.
        CheckpointError: If the file is no checkpoint of an agent, or damaged.
        TypeError: If the path is none.
    """
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"the path of a checkpoint must be a string or a Path, got {shown(path)}")
    path = Path(path)
    if flaw := find_flaw(path):
        raise CheckpointError(
            f"{path} is no whole checkpoint of a bra.Agent: {flaw}{_last_whole(path.parent)}"
        )
    try:
        checkpoint = torch.load(path, map_location=map_location, weights_only=True)
    except (RuntimeError, EOFError, LookupError, pickle.UnpicklingError) as error:
        raise CheckpointError(f"{path} is no checkpoint of a bra.Agent: {error}") from error
    if not isinstance(checkpoint, dict) or KEY not in checkpoint:
        raise CheckpointError(f"{path} is no checkpoint of a bra.Agent: it lacks the key {KEY!r}")
    _check_own(path, checkpoint)
    return checkpoint


def find_flaw(path: Path) -> str:
    """What is wrong with a file, by its checksum, or those of its parts; empty if nothing is."""
    if path.exists() and not path.is_file():
        return "it is a folder, device or pipe"
    with path.open("rb") as file:
        sealed = file.read()
    if sealed[-SEAL:].startswith(MARK):
        return "" if _seal(sealed[:-SEAL]) == sealed else "it does not match its checksum"
    try:
        with zipfile.ZipFile(path) as parts:
            damaged = parts.testzip()
            cut = parts.comment.startswith(MARK[2:])  # and ends somewhere else
    except (zipfile.BadZipFile, EOFError, NotImplementedError, ValueError, zlib.error) as error:
        return f"it is truncated, or of another kind ({error})"
    if cut:
        return "it does not match its checksum"
    return f"its part {damaged} does not match its checksum" if damaged else ""


def _last_whole(folder: Path) -> str:
    """The way out of a folder where a checkpoint is not whole."""
    found = sorted(folder.glob("*.ckpt"), key=lambda path: path.stat().st_mtime, reverse=True)
    whole = next((path for path in found if not find_flaw(path)), None)
    return f"; the last whole one is {whole}" if whole else ""


def write_checkpoint(checkpoint: dict[str, Any], path: str | os.PathLike[str]) -> None:
    """Writes a file that is never seen half-written: beside its place, and then moved there.

    Raises:
        OSError: If it cannot be written; what was in its place stays.
    """
    path = Path(path)
    part = path.with_name(f"{path.name}.part")
    buffer = io.BytesIO()
    torch.save(checkpoint, buffer)
    content = _seal(buffer.getvalue()[:-2])  # the length of its comment, which is none
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink()
        whole = _last_whole(path.parent)
        reason = error.strerror or error
        raise OSError(f"cannot write checkpoint {path}: {reason}{whole}") from error


def _seal(content: bytes) -> bytes:
    """A zip file, but for the two bytes in which it ends, with its checksum as its comment."""
    digest = hashlib.blake2b(content, digest_size=16).hexdigest().encode()
    return content + MARK + digest


def check_same_parts(
    saved: dict[str, Recipe], own: dict[str, Recipe], parts: Sequence[str] = FIXED_PARTS
) -> None:
    """Compares the recipes of the agent in a checkpoint and of the one that is to go on.

    Raises:
        CheckpointError: If one of the parts differs, or the number of agents.
    """
    agents, own_agents = _agents(saved), _agents(own)
    if agents != own_agents:
        raise CheckpointError(
            f"the checkpoint holds {agents}, this run trains {own_agents}; "
            "resume with the configuration it was trained with"
        )
    for part in parts:
        there, here = saved.get(part), own.get(part)  # classes of one's own may have others
        if not same_recipe(with_defaults(there), with_defaults(here)):
            raise CheckpointError(
                f"the checkpoint has {part} {describe_recipe(there)}, this agent "
                f"{describe_recipe(here)}; resume with the configuration it was trained with"
            )


def check_state(saved: dict[str, Any], own: dict[str, Tensor]) -> None:
    """Makes sure that a state dict can be loaded, and is worth it.

    Raises:
        CheckpointError: If tensors are missing, too many, of another shape, or hold NaN.
    """
    for name in sorted(saved.keys() | own.keys()):
        there, here = saved.get(name), own.get(name)
        if not (isinstance(there, Tensor) and here is not None and there.shape == here.shape):
            shapes = [tuple(t.shape) if isinstance(t, Tensor) else "nothing" for t in (there, here)]
            raise CheckpointError(
                f"the checkpoint's {name} has shape {shapes[0]}, this agent's {shapes[1]}"
            )
        if there.is_floating_point() != here.is_floating_point():
            raise CheckpointError(
                f"the checkpoint's {name} holds {there.dtype}, this agent's {here.dtype}"
            )
        if there.isnan().any():
            raise CheckpointError(f"the checkpoint's {name} holds NaN; take an earlier one")


def _check_own(path: Path, checkpoint: dict[str, Any]) -> None:
    """Makes sure that weights, counts and recipe are some."""
    saved = checkpoint[KEY] if isinstance(checkpoint[KEY], dict) else {}
    recipe = saved.get("recipe")
    seed = recipe.get("seed") if isinstance(recipe, dict) else None
    counts = {name: saved.get(name) for name in ("updates", "samples")} | {"seed": seed}
    if (run := saved.get("run")) is not None:
        counts["run"] = run
    wrong = [f"{n} {c!r}" for n, c in counts.items() if type(c) is not int or c < (n == "run")]
    parts = {"state_dict": dict, VERSION: str}
    wrong += [f"no {n}" for n, kind in parts.items() if not isinstance(checkpoint.get(n), kind)]
    wrong += [] if is_recipe(recipe) else ["a class without arguments"]
    if wrong:
        raise CheckpointError(f"{path} is no checkpoint of a bra.Agent: it holds {wrong[0]}")


def _agents(recipe: dict[str, Recipe]) -> str:
    """How many agents a recipe makes."""
    if "replicas" not in recipe:
        return "one agent"
    varied = (recipe.get(name) for name in VARIED)
    lengths = [len(values) if isinstance(values, list) else 1 for values in varied]
    settings = math.prod(lengths) if recipe["grid"] else max(lengths)
    return f"a population of {recipe['replicas'] * settings}"


def best_member(checkpoint: dict[str, Any]) -> dict[str, Any]:
    """Of a population's checkpoint, that of the agent that did best; of an agent's, itself."""
    saved = checkpoint[KEY]
    if "best" not in saved:
        return checkpoint
    weights = {name: stack[saved["best"]] for name, stack in checkpoint["state_dict"].items()}
    return {"state_dict": weights, KEY: saved | {"recipe": saved["best_recipe"]}}


def settle_epochs(fit_loop: dict[str, Any], updates_per_epoch: int) -> None:
    """Says which epochs are finished, and how far the next one is, by the number of updates.

    What Lightning notes depends on the moment: it counts an epoch that was stopped halfway as
    done, and one that a resumed run has begun as not begun, so that later runs would train too
    few epochs or too many.

    Args:
        fit_loop: The state of Lightning's fit loop, changed in place.
        updates_per_epoch: Updates of a whole epoch.
    """
    batches, epochs = fit_loop["epoch_loop.batch_progress"], fit_loop["epoch_progress"]
    updates = batches["total"]["processed"]
    finished, within = divmod(updates, updates_per_epoch)
    begun = finished + (within > 0)
    for progress in (epochs["total"], epochs["current"]):
        progress |= {"ready": begun, "started": begun, "processed": finished, "completed": finished}
    batches["total"] = dict.fromkeys(batches["total"], updates)
    batches["current"] = dict.fromkeys(batches["current"], within)
    batches["is_last_batch"] = False
    fit_loop["epoch_loop.state_dict"]["_batches_that_stepped"] = updates
