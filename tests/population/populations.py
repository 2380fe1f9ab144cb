"""Small populations, and what tests hold them against."""

from functools import partial
from pathlib import Path

import lightning.pytorch as pl
import torch
import training
from gymnasium.spaces import Box
from torch.distributions import Categorical

from bra import Agent, Population, PredatorPrey
from bra.channels import MLP, Multinomial
from bra.tasks import FiniteTask
from bra.update_rules import Projection

SEED = 3


def fit(learner, folder: Path, updates=200, batch_size=4, ckpt_path=None, **own) -> pl.Trainer:
    settings = {"max_epochs": 1, "accelerator": "cpu", "limit_val_batches": 0} | own
    return training.fit(learner, folder, 0, ckpt_path, batch_size, updates, **settings)


SETTINGS = {
    "task": PredatorPrey(observations="bipolar"),
    "perception": partial(MLP, hidden=[7]),
    "action": partial(Multinomial, start="covering"),
    "percepts": 5,
    "update_rule": Projection(),
}


def make_population(**own) -> Population:
    varied = {"replicas": 2, "beta_perception": [8.0, 1.0], "beta_action": 10.0, "seed": SEED}
    return Population(**(SETTINGS | varied | own))


def alone(population: Population, index: int, **own) -> Agent:
    """The agent that a member is to equal, from its settings."""
    setting = population.settings[index]
    rates = {
        f"{name}_optimizer": partial(own.pop(f"{name}_optimizer", torch.optim.Adam), lr=rate)
        for name in ("perception", "action")
        if (rate := getattr(setting, f"{name}_rate")) is not None
    }
    prices = {"beta_perception": setting.beta_perception, "beta_action": setting.beta_action}
    return Agent(**(SETTINGS | prices | own | rates), seed=setting.seed)


class Sensor(FiniteTask):
    """Four states whose signals are noisy."""

    def __init__(self) -> None:
        super().__init__(torch.eye(4), observations=Box(-9, 9, (4,)))

    def observe(self, state, generator):
        noise = torch.randn((len(state), 4), generator=generator)
        return (torch.eye(4)[state] + 0.3 * noise).to(torch.get_default_dtype())


class Dropping(MLP):
    """A channel that is disturbed while it learns."""

    def forward(self, condition):
        if not self.training:
            return super().forward(condition)
        kept = torch.rand((), dtype=torch.get_default_dtype()) < 0.9
        logits = super().forward(condition).logits
        return Categorical(logits=torch.where(kept, logits, -logits), validate_args=False)
