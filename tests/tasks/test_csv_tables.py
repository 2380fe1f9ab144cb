"""Tables of utilities in CSV files: used as they are meant, or refused with line and column."""

import math

import pytest

from bra import TableTask


@pytest.fixture
def hunt(tmp_path):
    """Writes a file and reads a task from it."""

    def read(text, **names):
        path = tmp_path / "hunt.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        for given in (path, str(path)):
            task = TableTask(given, **names)
        return task

    return read


@pytest.mark.parametrize(
    "text",
    [
        "state,stay,flee\nmouse,3.5,0.5\nlion,0,5\n",
        "\ufeffstate,stay,flee\nmouse,3.5,0.5\nlion,0,5\n",
        "\n\nstate,stay,flee\n\nmouse,3.5,0.5\n\n  ,  ,\nlion,0,5\n\n",
        " state ,  stay , flee \n mouse , 3.5 , 0.5\n lion, 0 ,  5",
        ",stay,flee\r\nmouse,3.5,0.5\r\nlion,0,5\r\n",
        "state,stay,flee\rmouse,3.5,0.5\rlion,0,5\r",
        'state,"stay","flee"\n"mouse","3.5","0.5"\nlion,0e0,5.0\n',
        "Unnamed: 0,stay,flee\nmouse,3.5,0.5\nlion,0,5\n",
        "state;stay;flee\nmouse;3.5;0.5\nlion;0;5\n",
        "state\tstay\tflee\nmouse\t3.5\t0.5\nlion\t0\t5\n",
        "\tstay\tflee\nmouse\t3.5\t0.5\nlion\t0\t5\n",
        "state,\tstay,\tflee\nmouse,\t3.5,\t0.5\nlion,\t0,\t5\n",
        "state;stay;flee\nmouse;3,5;0,5\nlion;0;5,000\n",
        "state\tstay\tflee\nmouse\t3,5\t0,5\nlion\t0\t5\n",
        'state,stay,flee\nmouse,"3,5","0,5"\nlion,0,5\n',
    ],
)
def test_table_from_csv(hunt, text):
    task = hunt(text)
    assert task.utilities.tolist() == [[3.5, 0.5], [0.0, 5.0]]
    assert task.state_names == ("mouse", "lion")
    assert task.action_names == ("stay", "flee")
    assert task.prior.tolist() == [0.5, 0.5]


@pytest.mark.parametrize(
    "text",
    [
        "state,prior,stay,flee\nmouse,.25,3,1\nlion,.75,0,5\n",
        "state;stay;flee;Prior\nmouse;3;1;0,25\nlion;0;5;0,75\n",
    ],
)
def test_a_file_may_carry_the_prior(hunt, text):
    task = hunt(text)
    assert task.prior.tolist() == [0.25, 0.75]
    assert task.utilities.tolist() == [[3.0, 1.0], [0.0, 5.0]]
    assert task.action_names == ("stay", "flee")
    assert hunt(text, prior=[0.5, 0.5]).prior.tolist() == [0.5, 0.5]
    with pytest.raises(ValueError, match=r"prior must sum to 1, got 1\.5"):
        hunt(text.replace("25", "75"))


def test_names_may_be_numbers_of_what_says_that_it_is_names(hunt):
    for corner in ("state", "", "Unnamed: 0"):
        task = hunt(f"{corner},10,20\n0,1,2\n1,3,4\n")
        assert (task.state_names, task.action_names) == (("0", "1"), ("10", "20"))


def test_names_given_go_before_names_in_the_file(hunt):
    text = "state,stay,flee\nmouse,3.5,0.5\nlion,0,5\n"
    task = hunt(text, state_names=["small", "large"], action_names=["a", "b"])
    assert task.state_names == ("small", "large")
    assert task.action_names == ("a", "b")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "hunt.csv is empty"),
        ("\n , \n\n", "hunt.csv is empty"),
        ("state,stay,flee\n", r"hunt.csv, line 1: .*got 2 actions and 0 states"),
        ("\nstate\nmouse\n", r"hunt.csv, line 2: .*got 0 actions and 1 state$"),
        ("state,prior\nmouse,1\n", r"line 1: .*got 0 actions and 1 state$"),
        ("state|stay|flee\nmouse|1|2\n", "line 1: .*separated by commas, semicolons or tabs"),
        ("state;a,b\nm;1,2\n", "line 1: cells may be separated by ',' or by ';'"),
        ("state,stay,flee\nmouse,3.5\n", r"hunt.csv, line 2: 1 value for 2 columns"),
        ("s,a,b\n\nmouse,1,2\nlion,1,2,3\n", r"hunt.csv, line 4: 3 values for 2 columns"),
        ("stay,flee\n3.5,0.5\n0,5\n", r"line 2, column 1: expected the name of a state, got 3.5"),
        ("1,2\n3,4\n", "line 1: expected a header row of action names"),
        ("s,a,\nmouse,1,2\n", r"line 1, column 3: expected the name of an action, got a blank"),
        ("s,a\n,1\n", r"line 2, column 1: expected the name of a state, got a blank"),
        ("s,a,a\nmouse,1,2\n", r"line 1, column 2: 'a' is there 2 times"),
        ("s,a\nm,1\nm,2\n", r"line 2, column 1: 'm' is there 2 times"),
        *(
            (f"s,a,{name}\nmouse,1,2\n", rf"line 1, column 3: '{name}' is hardly an action")
            for name in ("Total", "sum", "Unnamed: 3", "mean", "probability", "index")
        ),
        ("s,p(s),a\nm,1,2\n", r"line 1, column 2: 'p\(s\)' is hardly an action"),
        ("s,a,prior,Prior\nm,1,1,1\n", r"line 1, column 4: 'Prior' is hardly an action"),
        ("s,a\nm,1\nprior,1\n", r"line 3, column 1: 'prior' is hardly a state; .*as `prior`"),
        ("s,a\nm,1\nTotal,1\n", r"line 3, column 1: 'Total' is hardly a state; leave it out"),
        *(
            (f"s,a,b\nmouse,1,{cell}\n", rf"line 2, column 3 \(b\): expected a number.*'{cell}'")
            for cell in ("two", "", "1_000", "٣", "0x10", "10%", "−3", "1 000", "1e", "True", "--1")
        ),
        ('s,a\nmouse,"1,000"\n', r"line 2, column 2 \(a\): expected a number .*'1,000'"),
        ("s;a;b\nmouse;1,5;2.5\n", r"line 2, column 2 \(a\): expected a number .*'1,5'"),
        ("s,a,b\nmouse,1,nan\n", r"line 2, column 3 \(b\): utilities must be finite"),
        ("s,a,b\nmouse,1,2\nlion,inf,2\n", r"line 3, column 2 \(a\): utilities must be finite"),
        ("s,a\nmouse,1e400\n", r"line 2, column 2 \(a\): utilities must be finite"),
        ('s,a\n"mouse,1\nlion,2\n', "line 3: unexpected end of data; is a quotation mark left"),
        (f"s,a\n{'m' * 140_000},1\n", "line 2: field larger than field limit"),
        ("s,a\nJäger,1\n".encode("latin-1"), "not UTF-8 text; save it as CSV in UTF-8"),
        ("s,a\nmouse,1\n".encode("utf-16"), "not UTF-8 text"),
        ("s,a\nmouse,-inf\n", "got -inf for all of row 0"),
    ],
)
def test_bad_files_are_refused_with_file_line_and_column(hunt, text, message):
    with pytest.raises(ValueError, match=message) as caught:
        hunt(text)
    assert "\n" not in str(caught.value)


def test_missing_files_are_named(tmp_path):
    for path in (tmp_path / "nowhere.csv", tmp_path):
        with pytest.raises(ValueError, match=f"cannot read utilities from {path}: "):
            TableTask(path)


def test_a_file_may_forbid_actions(hunt):
    task = hunt("state,stay,flee\nmouse,1,-inf\nlion,-Infinity,5\n")
    assert task.utilities.tolist() == [[1.0, -math.inf], [-math.inf, 5.0]]


@pytest.mark.parametrize("names", ["ab", ["a", ""], ["a", None], [0, 1], ["a", "a"], ["a"]])
def test_names_that_are_none(names):
    with pytest.raises(ValueError, match="names"):
        TableTask([[1, 2], [3, 4]], state_names=names)
