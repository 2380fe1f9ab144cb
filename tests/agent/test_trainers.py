"""What agents make of the options of a trainer."""

from functools import partial

import pytest
import torch
from lightning.pytorch.strategies import FSDPStrategy
from torch.optim import SGD
from training import fit, make_trainer

from bra import Agent, Population, PredatorPrey, RolloutDataModule
from bra.agent.trainers import check_trainer, clip_norm
from bra.channels import MLP, Table
from bra.update_rules import ScoreFunction

OWN = {
    "perception": MLP,
    "action": Table,
    "percepts": 3,
    "update_rule": ScoreFunction(),
    "perception_optimizer": partial(SGD, lr=1.0),
    "action_optimizer": partial(SGD, lr=1.0),
}


def moved(learner, folder, **trainer):
    """By how much one step of plain descent moves each channel, (R, …): its gradient."""
    before = weights(learner)
    fit(learner, folder, max_steps=1, **trainer)
    return [new - old for new, old in zip(weights(learner), before, strict=True)]


def weights(learner):
    rows = len(learner.settings)
    channels = (learner.perception, learner.action)
    return [torch.cat([p.detach().reshape(rows, -1) for p in c.parameters()], 1) for c in channels]


@pytest.mark.parametrize("compile", [None, False, pytest.param(True, marks=pytest.mark.slow)])
def test_gradients_are_clipped_by_norm_each_agent_and_channel_by_itself(tmp_path, compile):
    def make():
        if compile is None:
            return Agent(PredatorPrey(), seed=0, **OWN)
        return Population(PredatorPrey(), 3, compile=compile, seed=0, **OWN)

    free = moved(make(), tmp_path)
    limit = 0.5 * min(step.norm(dim=1).min().item() for step in free)
    clipped = moved(make(), tmp_path, gradient_clip_val=limit)
    for step, other in zip(free, clipped, strict=True):
        assert torch.allclose(other, step * limit / step.norm(dim=1, keepdim=True), atol=1e-6)


def test_gradients_are_clipped_by_value(tmp_path):
    agent = partial(Agent, PredatorPrey(), seed=0, **OWN)
    options = {"gradient_clip_val": 0.1, "gradient_clip_algorithm": "value"}
    free, clipped = moved(agent(), tmp_path), moved(agent(), tmp_path, **options)
    assert any(step.abs().max() > 0.1 for step in free)
    for step, other in zip(free, clipped, strict=True):
        assert torch.allclose(other, step.clamp(-0.1, 0.1), atol=1e-6)


def test_the_norm_is_that_of_all_parameters():
    gradients = [torch.tensor([[3.0, 0.0], [0.3, 0.0]]), torch.tensor([[4.0], [0.4]])]
    clip_norm(gradients, 1.0)
    assert torch.allclose(gradients[0], torch.tensor([[0.6, 0.0], [0.3, 0.0]]))
    assert torch.allclose(gradients[1], torch.tensor([[0.8], [0.4]]))


def test_a_trainer_keeps_its_limit(tmp_path):
    agent = Agent(PredatorPrey(), seed=0, **OWN)
    trainer = fit(agent, tmp_path, max_steps=1, gradient_clip_val=1e-9)
    before = torch.cat([p.flatten() for p in agent.parameters()]).clone()
    trainer.fit_loop.epoch_loop.max_steps = 2
    trainer.fit(agent, RolloutDataModule(agent.task, 4, 10))
    after = torch.cat([p.flatten() for p in agent.parameters()])
    assert agent.updates == 2
    assert torch.allclose(after, before, atol=1e-7)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"accumulate_grad_batches": 2}, "accumulate_grad_batches must be 1, got 2: .*batch_size"),
        ({"precision": "16-true"}, "precision must be one of 32-true, .*, got 16-true"),
        ({"precision": "bf16-true"}, "precision must be one of 32-true, .*, got bf16-true"),
        (
            {"num_nodes": 2, "strategy": "ddp"},
            "num_nodes 2 would wait for nodes that nobody starts",
        ),
        ({"strategy": "ddp_spawn", "devices": 2}, "strategy must be auto or ddp, got ddp_spawn"),
        ({"strategy": "ddp_fork", "devices": 2}, "strategy must be auto or ddp, got ddp_fork"),
    ],
)
def test_what_cannot_be_followed_is_refused(tmp_path, options, line):
    with pytest.raises(ValueError, match=line):
        check_trainer(make_trainer(tmp_path, accelerator="cpu", **options))


def test_agents_refuse_by_themselves(tmp_path):
    with pytest.raises(ValueError, match="accumulate_grad_batches must be 1"):
        fit(Agent(PredatorPrey(), seed=0), tmp_path, accumulate_grad_batches=3)


def test_strategies_that_split_parameters_are_refused(tmp_path, monkeypatch):
    """Where there are GPUs; Lightning refuses them elsewhere."""
    trainer = make_trainer(tmp_path)
    monkeypatch.setattr(type(trainer), "strategy", FSDPStrategy())
    with pytest.raises(ValueError, match="strategy must be auto or ddp, got FSDPStrategy"):
        check_trainer(trainer)
