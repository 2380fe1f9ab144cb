"""Commands that do not train: baseline, frontier, export, validate, test, predict, help."""

import csv
import json
import re
import sys
from collections import Counter
from pathlib import Path

import pytest
from commands import QUICK, TARGETS, TASK, config, error_line, run

from bra import Agent
from bra.cli import main


def test_what_a_frontier_cannot_do_with_three_prices(capsys):
    agents = [config("medical.yaml"), "--agents"]
    assert "trains agents of two prices" in error_line(capsys, "frontier", *agents)


def test_export_writes_tidy_tables_of_agent_and_optimum(capsys, checkpoint):
    main(["export", f"--ckpt_path={checkpoint}"])
    agent, folder = Agent.load_from_checkpoint(checkpoint), Path("lightning_logs/version_0/export")
    tables = {}
    for path in folder.iterdir():
        with path.open(encoding="utf-8") as file:
            tables[path.stem] = list(csv.DictReader(file))
    assert {row["source"] for row in tables["percept_marginal"]} == {"agent", "optimum"}
    rows = [row for row in tables["action_given_state"] if row["source"] == "agent"]
    expected = agent.evaluation().action_given_state.flatten().tolist()
    assert [float(row["probability"]) for row in rows] == pytest.approx(expected, abs=1e-12)
    names = [[row["state"], row["action"]] for row in rows[:2]]
    assert names == [[agent.task.state_names[0], name] for name in agent.task.action_names[:2]]
    for name, given in (("percept_given_state", "state"), ("action_given_percept", "percept")):
        sums = Counter()
        for row in tables[name]:
            sums[row["source"], row[given]] += float(row["probability"])
        assert list(sums.values()) == pytest.approx([1.0] * len(sums))
    main(["fit", "--data.task=TargetTask", TARGETS, "--model.percepts=2", *QUICK])
    (checkpoint,) = Path("lightning_logs/version_1").rglob("last.ckpt")
    line = error_line(capsys, "export", f"--ckpt_path={checkpoint}")
    assert "export writes tables of finitely many" in line and "TargetTask" in line
    assert "cannot read nowhere.ckpt" in error_line(capsys, "export", "--ckpt_path=nowhere.ckpt")


def test_exported_tables_take_the_place_of_no_others(capsys, checkpoint):
    again = ["export", f"--ckpt_path={checkpoint}"]
    for _ in range(3):
        main(again)
    run = Path("lightning_logs/version_0")
    assert {path.name for path in run.glob("export*")} == {"export", "export_1", "export_2"}
    mine = Path("mine/action_marginal.csv")
    mine.parent.mkdir()
    mine.write_text("mine")
    line = error_line(capsys, *again, "--folder=mine")
    assert line == f"error: {mine} is there already; give another folder"
    assert [*Path("mine").iterdir()] == [mine] and mine.read_text() == "mine"


def test_frontier_writes_a_table_and_figures(capsys):
    Path("table.csv").write_text("state,stay,flee\nmouse,3,1\nlion,0,5\n")
    task = ["--data.task=TableTask", "--data.task.utilities=table.csv"]
    short = ["--points=3", "--agents", "--trainer.max_epochs=1", "--data.updates_per_epoch=10"]
    main(["frontier", *task, *short])
    out = capsys.readouterr().out
    assert "information becomes worth its price: 2 percepts" in out
    folder = Path("lightning_logs/version_0")
    with (folder / "frontier.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert Counter(row["kind"] for row in rows) == {"optimum": 5, "agent": 5}
    assert all(float(row["perception_information_bits"]) >= 0 for row in rows)
    assert (folder / "frontier.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "frontier.pdf").read_bytes().startswith(b"%PDF")
    Path("frontier.csv").write_text("mine")
    main(["frontier", *task, "--points=2", "--trainer.logger=false"])
    assert "lightning_logs/version_1/frontier.csv" in capsys.readouterr().out
    assert Path("frontier.csv").read_text() == "mine"


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--data.task=TargetTask", TARGETS, "--model.action=Gaussian"], "frontier needs a task"),
        ([TASK, "--model.beta_action=[1,2]"], "frontier scales one pair of prices"),
        ([TASK, "--points=0"], "points must be a whole number of at least 1, got 0"),
    ],
)
def test_what_has_no_frontier_is_said_in_one_line(capsys, args, words):
    assert words in error_line(capsys, "frontier", *args)


@pytest.mark.parametrize("budget", [(), ("--model.perception_bits=0.5",)], ids=["prices", "bits"])
def test_baseline_takes_the_restarts_of_the_monitor(budget, capsys, monkeypatch):
    asked = []
    for place in ("bra.cli.baseline.solve_all_references", "bra.cli.baseline.serial"):
        monkeypatch.setattr(place, lambda *args, **_: sys.exit(asked.append(args)))
    price = () if budget else ("--model.beta_perception=8",)
    task = ("--data.task=PredatorPrey", *price, "--model.beta_action=10", *budget)
    with pytest.raises(SystemExit):
        main(["baseline", *task, "--baseline.restarts=7", "--baseline.certify=3"])
    assert 7 in [value for value in asked[0] if isinstance(value, int)]


def test_frontiers_take_the_restarts_of_the_monitor(monkeypatch):
    asked = []
    monkeypatch.setattr(
        "bra.cli.frontier.frontier", lambda *args, **_: sys.exit(asked.append(args))
    )
    with pytest.raises(SystemExit):
        main(["frontier", TASK, "--model.percepts=3", "--baseline.restarts=7"])
    assert asked[0][6] == 7


def test_baseline_prints_the_optimum(capsys):
    main(["baseline", config("predator_prey.yaml")])
    assert "3.27049" in capsys.readouterr().out
    main(["baseline", config("predator_prey.yaml"), "--json"])
    optimum = json.loads(capsys.readouterr().out)
    assert optimum["objective"] == pytest.approx(3.27049, abs=1e-5)
    assert optimum["upper_bound"] == pytest.approx(3.27475, abs=1e-5)
    assert len(optimum["optima"]) == 32
    assert optimum["converged"] is True
    assert not Path("lightning_logs").exists()


def test_baselines_of_several_prices_have_the_third(capsys):
    task = ["--data.task=TableTask", "--data.task.utilities=[[1,0,0.5],[0,1,0.5]]"]
    prices = ["--model.beta_perception=[8,10]", "--model.beta_action=5", "--model.beta_direct=0.9"]
    main(["baseline", *task, *prices, "--baseline.restarts=2", "--json"])
    assert [o["beta_direct"] for o in json.loads(capsys.readouterr().out)] == [0.9, 0.9]


def test_validate_test_and_predict_use_a_checkpoint(capsys, checkpoint):
    reached = Agent.load_from_checkpoint(checkpoint).evaluate().objective
    agent = [TASK, "--model.percepts=4", f"--ckpt_path={checkpoint}"]
    capsys.readouterr()
    for command, shown in (("validate", str(reached)[:7]), ("test", f"{reached:.5f}")):
        main([command, *agent])
        assert shown in capsys.readouterr().out
    main(["predict", *agent, "--data.evaluation_worlds=5"])
    path = Path(re.search(r"5 rollouts in (\S+)", capsys.readouterr().out).group(1))
    header, *rows = path.read_text().splitlines()
    assert header == "state,percept,action,utility"
    assert len(rows) == 5
    assert all(row.startswith("size ") for row in rows)


def test_help_is_there(capsys):
    with pytest.raises(SystemExit) as end:
        main(["fit", "--help"])
    assert end.value.code == 0
    shown = capsys.readouterr().out.lower()
    for text in ("--model.perception", "--data.task", "--information", "Inverse price", "β₁"):
        assert text.lower() in shown


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        (
            ["--help"],
            0,
            "fit validate test predict baseline frontier export reproduce rollout outcomes help",
        ),
        (
            ["-h"],
            0,
            "fit validate test predict baseline frontier export reproduce rollout outcomes help",
        ),
        (["--version"], 0, "bra 0."),
        ([], 2, "command needed"),
        (["fti"], 2, "did you mean fit?"),
        (["fit", "--config", "nowhere.yaml"], 2, "config: cannot read nowhere.yaml: No such file"),
        (["fit", "--config=tabs.yaml"], 2, "config: tabs.yaml, line 2, is no YAML"),
        (["fit", "--config=list.yaml"], 2, "config: list.yaml must hold sections"),
        (["fit", "--config=latin.yaml"], 2, "config: cannot read latin.yaml: not UTF-8"),
        (["fit", "--config"], 2, "--config needs a file"),
        (["fit", "--config=."], 2, "config: . is no file, but a folder, device or pipe"),
    ],
)
def test_what_needs_no_torch_loads_none(args, code, words):
    Path("tabs.yaml").write_text("data:\n\ttask: PredatorPrey\n")
    Path("list.yaml").write_text("[data, model]\n")
    Path("latin.yaml").write_bytes("data: {task: Jäger}\n".encode("latin-1"))
    done = run(*args)
    assert done.returncode == code
    assert not re.search(r"\| +(torch|numpy|lightning)\b", done.stderr)
    said = [line for line in done.stderr.splitlines() if not line.startswith("import time:")]
    assert len(said) == (code == 2)
    for word in words.split():
        assert word in done.stdout + "".join(said)
