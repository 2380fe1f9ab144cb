"""People's arrays of any kind as tensors of one kind."""

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

Array = Sequence[Any] | np.ndarray | Tensor
"""Also pandas' tables and series, and paths of `.npy` and `.npz` files."""

_NO_NUMBERS = (str, bytes, complex, type(None))  # which NumPy might turn into some


def as_numbers(values: float | Array, expected: str) -> Tensor:
    """Values as a float64 tensor of its own, on the CPU and outside any graph.

    Args:
        values: Numbers of any real type and byte order; or the path of a `.npy` file, or of an
            `.npz` file that holds one array.
        expected: How an error begins: what has to be what.

    Raises:
        ValueError: If they are ragged, complex, masked or no numbers, or the file cannot be read.
    """
    try:
        array = _as_array(values)
        if array.dtype == "O" and any(isinstance(v, _NO_NUMBERS) for v in array.flat):
            raise ValueError("text, None or complex numbers among them")
        if array.dtype.kind not in "biufO":
            raise ValueError(f"values of type {array.dtype}")
        with np.errstate(over="ignore"):  # beyond float64 is infinite, which callers refuse
            return torch.from_numpy(array.astype(np.float64, order="C"))
    except (TypeError, ValueError, RuntimeError, OSError) as error:
        given = os.fspath(values) if isinstance(values, os.PathLike) else values
        got, reason = " ".join(repr(given).split()), " ".join(str(error).split())
        raise ValueError(f"{expected}, got {got:.60} ({reason:.120})") from error


def check_numbers(numbers: float | Array, name: str) -> Tensor:
    """Numbers as a float64 tensor of its own and of their shape.

    Raises:
        ValueError: If there are none, or they are no numbers.
    """
    values = as_numbers(numbers, f"{name} must be a number or an array of numbers")
    if values.numel() == 0:
        raise ValueError(f"{name} must hold at least one number, got shape {tuple(values.shape)}")
    return values


def names_of(values: Any) -> tuple[list[str] | None, list[str] | None]:
    """Names of rows and columns that a pandas table or series carries; None where they count."""
    index, columns = getattr(values, "index", None), getattr(values, "columns", None)
    return _labels(index), _labels(columns)


def _as_array(values: Any) -> np.ndarray:
    """NumPy's view of values.

    Raises:
        ValueError: If cells are masked, or a file is no single array.
    """
    if isinstance(values, str | os.PathLike):
        values = _load(os.fspath(values))
    if isinstance(values, Tensor):
        values = values.detach().cpu().to_dense().resolve_conj().resolve_neg()
        values = values.double() if values.dtype == torch.bfloat16 else values.numpy()
    if np.ma.isMaskedArray(values) and np.ma.getmaskarray(values).any():
        cell = np.argwhere(np.ma.getmaskarray(values))[0].tolist()
        raise ValueError(f"a masked value at {cell}; fill it")
    return np.asarray(values)


def _load(path: str) -> Any:
    if not path.endswith((".npy", ".npz")):
        raise ValueError("text; paths are those of .npy or .npz files")
    if os.path.exists(path) and not os.path.isfile(path):
        raise ValueError("a folder, device or pipe")
    try:
        loaded = np.load(path, allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise ValueError("a file that holds no numbers, or not all of them") from error
    if isinstance(loaded, np.ndarray):
        return loaded
    with loaded:
        if len(loaded.files) != 1:
            raise ValueError(f"a file of {len(loaded.files)} arrays; save one alone")
        return loaded[loaded.files[0]]


def _labels(index: Any) -> list[str] | None:
    """An index's labels, unless it is none, or counts from 0."""
    if index is None or callable(index) or list(index) == list(range(len(index))):
        return None
    return [str(label) for label in index]
