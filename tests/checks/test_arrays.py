"""Arrays of any kind mean their numbers, or are refused in one line."""

from decimal import Decimal
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from bra import Agent, Cooling, TableTask
from bra.blahut_arimoto import rate_distortion
from bra.channels import CNN, Multinomial
from bra.checks.arrays import as_numbers

TABLE = [[1.0, 2.5], [3.0, -4.0]]


@pytest.mark.parametrize(
    "values",
    [
        np.array(TABLE, ">f8"),
        np.array(TABLE, ">f4"),
        np.array(TABLE, np.longdouble),
        np.array(TABLE, np.float16),
        np.array(TABLE, object),
        [[Decimal("1"), Decimal("2.5")], [3, -4]],
        np.ma.masked_invalid(TABLE),
        np.array(TABLE)[::-1][::-1],
        np.asfortranarray(TABLE),
        torch.tensor(TABLE, dtype=torch.bfloat16),
        torch.tensor(TABLE).to_sparse(),
        torch.tensor(TABLE, requires_grad=True) * 1,
        [torch.tensor([1.0, 2.5]), torch.tensor([3.0, -4.0])],
    ],
)
def test_numbers_of_any_type(values):
    numbers = as_numbers(values, "values must be numbers")
    assert numbers.dtype == torch.float64
    assert numbers.tolist() == TABLE
    assert not numbers.requires_grad


@pytest.mark.parametrize(
    "values, reason",
    [
        (np.ma.masked_greater(TABLE, 2.9), r"a masked value at \[1, 0\]; fill it"),
        (np.array(TABLE) * 1j, "values of type complex128"),
        (torch.tensor(TABLE) * 1j, "values of type complex64"),
        (np.array([[1, 2j]], object), "text, None or complex numbers"),
        ([["1", "2"]], "values of type <U1"),
        (np.array([["1_000", 2]], object), "text, None or complex"),
        (np.array([["2020-01-01"]], "M8[D]"), "values of type datetime64"),
        ([[1.0], [1.0, 2.0]], "inhomogeneous"),
        ({"a": 1}, "must be"),
        ("nowhere.npy", "No such file"),
        ("hello", "paths are those of .npy or .npz files"),
    ],
)
def test_what_is_no_table(values, reason):
    uses = [lambda table: rate_distortion(table, None, 1.0)]
    if not isinstance(values, str):  # the task takes other paths too
        uses.append(TableTask)
    for use in uses:
        with pytest.raises(ValueError, match=reason) as caught:
            use(values)
        assert str(caught.value).startswith("utilities must be a table of numbers")
        assert "\n" not in str(caught.value)


def test_tasks_have_copies():
    signals, prior = np.eye(2, dtype=np.float32), np.array([0.5, 0.5])
    table = np.array(TABLE)
    task = TableTask(table, prior, signals)
    for array in (signals, prior, table):
        array[:] = 7
    assert task.utilities.tolist() == TABLE
    assert task.prior.tolist() == [0.5, 0.5]
    assert task.observations.tolist() == [[1, 0], [0, 1]]


@pytest.mark.parametrize("kind", [np.uint8, torch.uint8])
def test_8_bit_images_are_scaled(kind):
    images = np.arange(2 * 64, dtype=np.uint8).reshape(2, 1, 8, 8) * 2
    given = images if kind is np.uint8 else torch.tensor(images)
    ours = Agent(TableTask(TABLE, observations=given), CNN, Multinomial, 2, seed=0)
    theirs = Agent(TableTask(TABLE, observations=images / 255), CNN, Multinomial, 2, seed=0)
    torch.testing.assert_close(ours.behaviour(), theirs.behaviour())


def test_codes_of_8_bits_are_no_images():
    task = TableTask(TABLE, observations=np.eye(2, dtype=np.uint8))
    assert task.observations.dtype == torch.float32


def test_files_of_numpy(tmp_path):
    np.save(tmp_path / "table.npy", np.array(TABLE))
    np.savez(tmp_path / "table.npz", np.array(TABLE))
    for name in ("table.npy", "table.npz"):
        assert TableTask(tmp_path / name).utilities.tolist() == TABLE
        assert rate_distortion(str(tmp_path / name), None, 1.0).converged
    np.savez(tmp_path / "two.npz", np.array(TABLE), np.array(TABLE))
    with pytest.raises(ValueError, match=r"a file of 2 arrays; save one alone"):
        TableTask(tmp_path / "two.npz")


class Frame(SimpleNamespace):
    """What `pandas.DataFrame` shows of itself."""

    def __array__(self, dtype=None, copy=None):
        return np.array(self.values, dtype)


def test_tables_of_pandas_bring_names():
    frame = Frame(values=TABLE, index=["mouse", "lion"], columns=["stay", "flee"])
    task = TableTask(frame, Frame(values=[0.2, 0.8], index=["mouse", "lion"]))
    assert (task.state_names, task.action_names) == (("mouse", "lion"), ("stay", "flee"))
    counted = TableTask(Frame(values=TABLE, index=range(2), columns=range(2)))
    assert counted.state_names == ("s0", "s1")
    with pytest.raises(ValueError, match=r"prior is of states \['lion', 'mouse'\].*in order"):
        TableTask(frame, Frame(values=[0.8, 0.2], index=["lion", "mouse"]))
    with pytest.raises(ValueError, match=r"'prior' is hardly an action; leave it out"):
        TableTask(Frame(values=TABLE, index=["mouse", "lion"], columns=["stay", "prior"]))


@pytest.mark.parametrize(
    "utilities, beta, what",
    [
        (TABLE, 1e-40, "beta_perception"),
        (TABLE, 1e39, "beta_perception"),
        ([[0, 1e39], [1, 0]], 1.0, "what utilities of a state differ by"),
        ([[0, 1e-300], [0, 0]], 1.0, "what utilities of a state differ by"),
    ],
)
def test_what_channels_cannot_represent(utilities, beta, what):
    with pytest.raises(ValueError, match=f"^{what} must be between 5.4e-20 and 1.8e\\+19 for"):
        Agent(TableTask(utilities), beta_perception=beta)


def test_what_channels_cannot_represent_while_prices_cool():
    name = "beta_action times the factor of cooling"
    with pytest.raises(ValueError, match=rf"^{name} must be between .*, got 1e-20; U/c at prices"):
        Agent(TableTask(TABLE), cooling=Cooling(1.0, 10, action_factor=1e-20))
    with pytest.raises(ValueError, match=r"^beta_direct must be between .*, got 1e-30"):
        Agent(TableTask(TABLE), beta_direct=1e-30)
