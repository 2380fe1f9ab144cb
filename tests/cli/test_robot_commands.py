"""`bra rollout` and `bra outcomes`, called as a user calls them."""

import csv
import re
from pathlib import Path

import pytest
from PIL import Image

from bra.cli import main

FIT = [
    "fit",
    "--data.task=NaoMugs",
    "--data.updates_per_epoch=2",
    "--trainer.max_epochs=1",
    "--model.percepts=4",
    "--behaviour=null",
]
CHECKPOINT = "lightning_logs/version_0/checkpoints/last.ckpt"


@pytest.fixture(autouse=True)
def without_a_display(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)


def error_line(capsys, *args):
    with pytest.raises(SystemExit) as exit_:
        main(list(args))
    assert exit_.value.code == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
    assert line.startswith("error: ")
    return line


def test_a_trained_agent_in_the_scene(capsys, monkeypatch):
    monkeypatch.setattr("bra.cli.robot.FRAMES_APART", 40)
    main(FIT)
    capsys.readouterr()
    main(["rollout", f"--ckpt_path={CHECKPOINT}", "--episodes=5", "--film=[2, 3]"])
    printed = capsys.readouterr().out
    episodes = re.findall(r"^ +(\d)  (m\w) +(x\d) +(a\w) +(.*\S) +(\d\.\d\d)$", printed, re.M)
    assert [episode[0] for episode in episodes] == list("12345")
    utilities = {"m0a0": 5, "mLaL": 5, "mRaR": 5, "m2a2": 5, "mLa2": 3, "mRa2": 3}
    for _, mug, _, action, outcome, utility in episodes:
        assert float(utility) == utilities.get(mug + action, 0)
        lifted = mug + action in ("mLaL", "mRaR", "mLa2", "mRa2", "m2aL", "m2aR", "m2a2")
        assert outcome.startswith("lifted") is lifted
    table = re.findall(r"^(m[0LR2]) +(.*) +(\d)/(\d)", printed, re.M)
    assert sum(int(row[3]) for row in table) == 5
    mean = sum(float(episode[5]) for episode in episodes) / 5
    assert f"mean utility of 5 episodes: {mean:.3f}" in printed
    with Image.open("lightning_logs/version_0/rollout.gif") as film:
        assert film.n_frames > 3 and film.size == (696, 360)
        assert film.info["loop"] == 0

    main(["rollout", f"--ckpt_path={CHECKPOINT}", "--episodes=5", "--film=[]"])
    again = capsys.readouterr().out
    assert printed.startswith(again.rstrip())  # the same encounters, and no film
    assert "no display" in error_line(capsys, "rollout", f"--ckpt_path={CHECKPOINT}", "--gui")
    line = error_line(capsys, "rollout", f"--ckpt_path={CHECKPOINT}", "--film=[13]")
    assert line == "error: film must name episodes from 1 to 12, got [13]"
    line = error_line(capsys, "rollout", f"--ckpt_path={CHECKPOINT}", "--episodes=0")
    assert "episodes must be" in line
    line = error_line(capsys, "rollout", f"--ckpt_path={CHECKPOINT}", "--seed=-1")
    assert line == "error: seed must be at least 0, got -1"


def test_rollout_of_other_agents(capsys, checkpoint):
    capsys.readouterr()
    line = error_line(capsys, "rollout", f"--ckpt_path={checkpoint}")
    assert "rollout shows agents of NaoMugs, this one's task is PredatorPrey" in line
    line = error_line(capsys, "rollout", "--ckpt_path=nowhere.ckpt")
    assert line == "error: ckpt_path: cannot read nowhere.ckpt: No such file or directory"
    assert "ckpt_path" in error_line(capsys, "rollout")
    assert "unknown key episode" in error_line(capsys, "rollout", "--ckpt_path=x", "--episode=3")


def test_outcomes(capsys):
    main(["outcomes", "--trials=1", "--folder=measured"])
    printed = capsys.readouterr().out
    assert re.search(r"^mL +0/1 +1/1 +0/1 +1/1$", printed, re.M)
    rows = list(csv.DictReader(Path("measured/outcomes.csv").open(encoding="utf-8")))
    assert len(rows) == 16
    lifted = {row["mug"] + row["action"] for row in rows if row["successes"] == "1"}
    assert lifted == {"mLaL", "mLa2", "mRaR", "mRa2", "m2aL", "m2aR", "m2a2"}
    with Image.open("measured/outcomes.png") as picture:
        assert min(picture.size) > 200
    line = error_line(capsys, "outcomes", "--position_jitter=0.3")
    assert "position_jitter 0.3 m" in line and "the hands do not reach" in line
    assert "nowhere.urdf" in error_line(capsys, "outcomes", "--robot=nowhere.urdf")
    assert "trials" in error_line(capsys, "outcomes", "--trials=0")


def test_without_pybullet(capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pybullet", None)
    for command in (FIT, ["outcomes"]):
        line = error_line(capsys, *command)
        assert line.startswith("error: NaoMugs needs pybullet, which cannot be imported")
    main(["fit", "--data.task=PredatorPrey", *FIT[2:]])
    assert Path(CHECKPOINT).exists()


def test_frames_in_tensorboard(monkeypatch):
    monkeypatch.setattr("bra.evaluation.worlds.EVALUATION_WORLDS", 64)
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    main([*FIT, "--data.task.position_jitter=0.01", "--data.evaluation_worlds=64"])
    events = EventAccumulator("lightning_logs/version_0", size_guidance={"images": 0})
    events.Reload()
    pictures = events.Images("observations/percept_and_action")
    assert [picture.step for picture in pictures] == [0, 1, 2]
    # Four frames across and four down, with their captions and margins.
    assert (pictures[0].width, pictures[0].height) == (660, 4 * (120 + 24 + 4) + 4)
    assert "information/state_bits" in events.Tags()["scalars"]
