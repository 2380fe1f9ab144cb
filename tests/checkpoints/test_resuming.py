"""Going on from a checkpoint with other settings, or from one that is no state to go on from."""

import sys
from pathlib import Path

import pytest
import torch
from training import fit

from bra import Agent, PredatorPrey
from bra.channels import MLP, Multinomial
from bra.checkpoints.files import CheckpointError
from bra.cli import main

SHORT = ["--data.task=PredatorPrey", "--model.percepts=13", "--model.beta_action=10"]
SHORT += ["--model.perception=MLP", "--model.action=Multinomial"]
SHORT += ["--data.updates_per_epoch=3", "--baseline=null", "--behaviour=null"]
SHORT += ["--trainer.enable_progress_bar=false", "--trainer.max_epochs=2", "--data.batch_size=2"]
RULES = ["--model.update_rule=ScoreFunction"]


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("saved")
    main(["fit", *SHORT, "--trainer.max_epochs=1", f"--trainer.default_root_dir={folder}"])
    return folder / "lightning_logs/version_0"


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])


def refusal(capsys, *words):
    with pytest.raises(SystemExit) as end:
        main([*words])
    lines = [line for line in capsys.readouterr().err.splitlines() if line]
    assert end.value.code == 2 and not any("Traceback" in line for line in lines)
    assert lines[-1].startswith("error: ")
    return lines[-1]


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (
            ["--model.perception_optimizer=Adam", "--model.perception_optimizer.lr=0.5"],
            "perception_optimizer Adam(lr=0.05",
        ),
        (["--model.action_optimizer=SGD"], "action_optimizer Adam(lr=0.3"),
        (RULES, "update_rule Projection("),
        (["--model.marginals=BatchMarginals"], "marginals ExactMarginals()"),
        (
            ["--model.action_scheduler=ExponentialLR", "--model.action_scheduler.gamma=0.9"],
            "action_scheduler None, this agent ExponentialLR(gamma=0.9",
        ),
        (["--model.replicas=2"], "one agent, this run trains a population of 2"),
    ],
)
def test_other_parts_are_refused_by_name(saved, capsys, other, said):
    line = refusal(capsys, "fit", *SHORT, f"--ckpt_path={saved}/checkpoints/last.ckpt", *other)
    assert said in line and "resume with the configuration it was trained with" in line


def test_its_own_configuration_and_other_prices_go_on(saved):
    path = saved / "checkpoints/last.ckpt"
    longer = [f"--ckpt_path={path}", "--trainer.max_epochs=2", "--trainer.default_root_dir=."]
    longer += ["--behaviour=null", "--baseline=null"]
    main(["fit", f"--config={saved}/config.yaml", *longer])
    main(["fit", *SHORT, f"--ckpt_path={path}", "--model.beta_action=3.0"])
    for version, beta in ((0, 10.0), (1, 3.0)):
        run = f"lightning_logs/version_{version}/checkpoints/last.ckpt"
        agent = Agent.load_from_checkpoint(run)
        assert (agent.updates, agent.beta_action) == (6, beta)


def slots(checkpoint):
    return checkpoint["optimizer_states"][1]["state"][0]


def edited(saved, edit):
    checkpoint = torch.load(saved / "checkpoints/last.ckpt", weights_only=True)
    edit(checkpoint)
    torch.save(checkpoint, "edited.ckpt")
    return "--ckpt_path=edited.ckpt"


STATES = [
    (lambda c: c.pop("optimizer_states"), "holds weights only"),
    (lambda c: next(iter(c["state_dict"].values())).fill_(torch.nan), "holds NaN"),
    (lambda c: c["state_dict"].popitem(), "has shape nothing, this agent's"),
    (
        lambda c: c["bra"].update(updates=-3),
        "no checkpoint of a bra.Agent: it holds updates -3",
    ),
    (lambda c: c["bra"].update(run=0), "it holds run 0"),
    (lambda c: c["bra"]["recipe"].pop("seed"), "it holds seed None"),
    (lambda c: c["bra"]["recipe"].update(seed=-1), "it holds seed -1"),
    (lambda c: c["bra"].update(recipe=None), "it holds seed None"),
    (lambda c: c.pop("state_dict"), "it holds no state_dict"),
    (lambda c: c.pop("loops"), "the checkpoint's loops holds None: no state to go on from"),
    (lambda c: c.update(loops={}), "the checkpoint's loops lacks fit_loop: no state to go on"),
    (
        lambda c: c["loops"]["fit_loop"]["epoch_progress"]["total"].update(ready=-1),
        "loops.fit_loop.epoch_progress.total.ready holds -1: no state",
    ),
    (
        lambda c: c["loops"].update(fit_loop=torch.zeros(3)),
        "loops.fit_loop holds a tensor (3,)",
    ),
    (lambda c: c.pop("lr_schedulers"), "lr_schedulers holds None"),
    (lambda c: c.update(callbacks=[1]), "callbacks holds [1]"),
    (lambda c: c["optimizer_states"].pop(), "optimizer_states holds [{"),
    (lambda c: c.update(optimizer_states="x"), "optimizer_states holds 'x'"),
    (lambda c: slots(c).pop("exp_avg"), "optimizer_states.1.state.0 lacks exp_avg"),
    (lambda c: slots(c).update(exp_avg="x"), "optimizer_states.1.state.0.exp_avg holds 'x'"),
    (
        lambda c: slots(c).update(exp_avg=torch.zeros(7)),
        "optimizer_states.1.state.0.exp_avg holds a tensor (7,)",
    ),
    (
        lambda c: slots(c)["exp_avg"].fill_(torch.nan),
        "exp_avg holds a tensor (8, 13) of torch.float32, not all of it finite",
    ),
    (
        lambda c: c["optimizer_states"][0]["param_groups"][0].update(lr=-1.0),
        "optimizer_states.0.param_groups.0.lr holds -1.0",
    ),
    (
        lambda c: c["optimizer_states"][0]["param_groups"][0].update(betas=0.9),
        "optimizer_states.0.param_groups.0.betas holds 0.9",
    ),
    (
        lambda c: c.update(state_dict={n: t.long() for n, t in c["state_dict"].items()}),
        "holds torch.int64, this agent's torch.float32",
    ),
    (
        lambda c: c["bra"].update(updates=float("nan")),
        "no checkpoint of a bra.Agent: it holds updates nan",
    ),
]


@pytest.mark.parametrize(("edit", "said"), STATES)
def test_what_is_no_state_to_go_on_from_is_refused(saved, edit, said):
    edited(saved, edit)
    agent = Agent(PredatorPrey(), MLP, Multinomial, 13, beta_action=10.0, seed=0)
    with pytest.raises(CheckpointError) as caught:
        fit(agent, Path(), ckpt_path="edited.ckpt", max_epochs=2, batch=2, updates=3)
    assert said in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(("edit", "said"), STATES[::6])
def test_what_is_no_state_is_told_by_the_command(saved, capsys, edit, said):
    assert said in refusal(capsys, "fit", *SHORT, edited(saved, edit))


def test_tests_do_not_mind_what_they_do_not_need(saved, capsys):
    def bare(checkpoint):
        for key in ("optimizer_states", "lr_schedulers", "loops"):
            checkpoint.pop(key)

    main(["test", *SHORT, f"--ckpt_path={saved}/checkpoints/last.ckpt"])
    expected = capsys.readouterr().out
    optimizer = "--model.perception_optimizer=SGD"
    main(["test", *SHORT, edited(saved, bare), *RULES, optimizer])
    assert capsys.readouterr().out.replace("version_1", "version_0") == expected
