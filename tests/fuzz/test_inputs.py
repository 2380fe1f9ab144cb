"""Whatever is handed over is used as it is meant, or refused in one line: drawn by hypothesis.

The files in `inputs` are what people were seen to hand over. One more in their folders is one more
test, and one more for hypothesis to change here and there.
"""

import csv
import io
import math
import string
import tempfile
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from bra import TableTask
from bra.blahut_arimoto import rate_distortion
from bra.checks.arrays import as_numbers
from bra.checks.prices import check_betas
from bra.checks.tables import check_prior
from bra.cli.configurations import check_configuration, compose
from bra.tasks.csv_tables import CORNERS, PRIOR, SUSPECTS, read_utilities

INPUTS = Path(__file__).parent / "inputs"
PLAIN = settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(HealthCheck),
)
AMOUNTS = [PLAIN, pytest.param(settings(PLAIN, max_examples=5000), marks=pytest.mark.slow)]

fuzzed = pytest.mark.parametrize("drawn", AMOUNTS, ids=["few", "many"])
utilities = st.floats(-1e6, 1e6, width=32)
names = st.text(string.ascii_letters + string.digits + " ,;'ΩÄ-", min_size=1, max_size=8).map(
    str.strip
)


def files(kind):
    return sorted((INPUTS / kind).iterdir())


def read(data):
    """What a CSV file of these bytes says, or the line that refuses it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.csv"
        path.write_bytes(data)
        try:
            return read_utilities(str(path))
        except ValueError as error:
            assert str(path) in str(error)
            assert "\n" not in str(error).replace(repr("\n"), "")
            return str(error)


def configuration(data, capsys):
    """The line that refuses a configuration of these bytes; empty if it is taken."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.yaml"
        path.write_bytes(data)
        try:
            check_configuration(path)
            return ""
        except SystemExit as end:
            assert end.code == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert line.startswith("error: config: ")
            return line


@pytest.mark.parametrize("path", files("csv_taken"), ids=lambda path: path.stem)
def test_tables_that_are_taken(path):
    assert TableTask(path).utilities.shape == (2, 2)


@pytest.mark.parametrize("path", files("csv_refused"), ids=lambda path: path.stem)
def test_tables_that_are_refused(path):
    with pytest.raises(ValueError, match=r"csv|prior must sum to 1"):
        TableTask(path)


@pytest.mark.parametrize("path", files("yaml_taken"), ids=lambda path: path.stem)
def test_configurations_that_are_taken(path, capsys):
    assert not configuration(path.read_bytes(), capsys)


@pytest.mark.parametrize("path", files("yaml_refused"), ids=lambda path: path.stem)
def test_configurations_that_are_refused(path, capsys):
    assert configuration(path.read_bytes(), capsys)


SHORT = {
    kind: [path.read_bytes() for path in files(kind) if path.stat().st_size < 1000]
    for kind in ("csv_taken", "csv_refused", "yaml_taken", "yaml_refused")
}


@st.composite
def changed(draw, kinds):
    """A file with some bytes left out, doubled, or put in."""
    data = draw(st.sampled_from([text for kind in kinds for text in SHORT[kind]]))
    for _ in range(draw(st.integers(0, 4))):
        start, end = sorted(draw(st.integers(0, len(data))) for _ in range(2))
        new = draw(st.sampled_from([b"", data[start:end] * 2, b",", b";", b"\n", b'"', b"&a *a"]))
        data = data[:start] + (new or draw(st.binary(max_size=3))) + data[end:]
    return data


@fuzzed
def test_any_bytes_as_a_table(drawn):
    @drawn
    @given(st.binary(max_size=80) | changed(["csv_taken", "csv_refused"]))
    def check(data):
        table = read(data)
        if isinstance(table, str):
            return
        shape = np.shape(table.utilities)
        assert shape == (len(table.state_names), len(table.action_names))
        assert not np.isnan(table.utilities).any() and not np.isposinf(table.utilities).any()
        for given_names in (table.state_names, table.action_names):
            assert len(set(given_names)) == len(given_names) and all(given_names)
            assert not any(SUSPECTS.fullmatch(name) for name in given_names)

    check()


@st.composite
def tables(draw):
    """A table, its names, and how to write it."""
    states, actions = (
        draw(st.lists(names.filter(bool), min_size=1, max_size=4, unique=True)) for _ in range(2)
    )
    assume(not any(SUSPECTS.fullmatch(name) for name in (*states, *actions)))
    row = st.lists(utilities, min_size=len(actions), max_size=len(actions))
    values = draw(st.lists(row, min_size=len(states), max_size=len(states)))
    return states, actions, values, draw(st.sampled_from(",;\t")), draw(st.sampled_from(".,"))


@fuzzed
def test_what_is_written_is_read(drawn):
    @drawn
    @given(tables(), st.sampled_from(CORNERS), st.booleans())
    def check(table, corner, with_prior):
        states, actions, values, separator, point = table
        if with_prior:
            prior = [0.5 ** min(n + 1, len(states) - 1) for n in range(len(states))]
            rows = [[*row, p] for row, p in zip(values, prior, strict=True)]
        else:
            prior, rows = None, values
        file = io.StringIO()
        writer = csv.writer(file, delimiter=separator)
        writer.writerow([corner, *actions, *[PRIOR] * with_prior])
        for name, row in zip(states, rows, strict=True):
            writer.writerow([name, *(f"{value:.9g}".replace(".", point) for value in row)])
        found = read(file.getvalue().encode())
        if isinstance(found, str):  # which may be meant in two ways
            assert point == "," or separator != "," or len(actions) == 1, found
            return
        assert (found.state_names, found.action_names) == (states, actions)
        assert found.prior == (prior and pytest.approx(prior))
        np.testing.assert_allclose(found.utilities, values, rtol=1e-8)

    check()


@fuzzed
def test_any_bytes_as_a_configuration(drawn, capsys):
    @drawn
    @given(st.binary(max_size=60) | changed(["yaml_taken", "yaml_refused"]))
    def check(data):
        if not configuration(data, capsys):
            assert isinstance(yaml.safe_load(data.decode("utf-8-sig")), dict)

    check()


plain_values = st.none() | st.booleans() | st.integers(-99, 99) | st.text("abc", max_size=3)
trees = st.recursive(
    plain_values,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.text("abc", min_size=1, max_size=3), inner, max_size=3)
    ),
    max_leaves=12,
)


@fuzzed
def test_yaml_of_anything_is_taken_as_it_is(drawn):
    @drawn
    @given(trees)
    def check(tree):
        text = yaml.safe_dump(tree)
        assert yaml.serialize(compose(text)) == yaml.serialize(yaml.compose(text))

    check()


things = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.complex_numbers()
    | st.text(max_size=3)
    | st.binary(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=2), inner),
    max_leaves=9,
)


@fuzzed
def test_anything_as_numbers_priors_and_prices(drawn):
    @drawn
    @given(things)
    def check(thing):
        for use in (
            lambda: as_numbers(thing, "it must be numbers"),
            lambda: check_prior(thing, 2),
            lambda: check_betas(thing, "beta"),
            lambda: TableTask(thing).utilities,
        ):
            try:
                assert use().dtype == torch.float64
            except ValueError as error:
                assert "\n" not in str(error) and len(str(error)) < 400

    check()


@fuzzed
def test_priors_are_distributions(drawn):
    @drawn
    @given(st.lists(st.floats(0, 1e6, width=32), min_size=1, max_size=6), st.floats(-1e-7, 1e-7))
    def check(weights, error):
        total = math.fsum(weights)
        assume(total > 1e-6)
        prior = check_prior([weight / total * (1 + error) for weight in weights], len(weights))
        assert prior.sum().item() == pytest.approx(1, abs=1e-12)
        assert (prior >= 0).all()

    check()


@fuzzed
def test_optima_keep_what_theory_says(drawn):
    @settings(drawn, max_examples=drawn.max_examples // 2)
    @given(
        st.lists(
            st.lists(st.floats(-9, 9, width=16), min_size=3, max_size=3), min_size=2, max_size=3
        ),
        st.floats(0.01, 100),
        st.floats(-1e3, 1e3),
    )
    def check(table, beta, offset):
        found = rate_distortion(table, None, beta)
        best = np.max(table, axis=1).mean()
        constant = np.mean(table, axis=0).max()
        assert constant - 1e-9 <= found.objective <= found.upper_bound + 1e-12
        assert found.expected_utility <= best + 1e-9
        assert -1e-12 <= found.end_to_end_information <= math.log(len(table)) + 1e-12
        moved = rate_distortion(np.array(table) + offset, None, beta)
        assert moved.objective - offset == pytest.approx(found.objective, abs=1e-6)

    check()
