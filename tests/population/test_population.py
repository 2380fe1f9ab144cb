"""A member of a population goes the way that an agent goes alone."""

from types import SimpleNamespace

import lightning.pytorch as pl
import pytest
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from populations import SETTINGS, Dropping, Sensor, alone, fit, make_population

from bra import Agent, Cooling, Population
from bra.marginals import RunningMarginals
from bra.tasks.datamodule import WorldStream
from bra.update_rules import ExactGradient, Projection, ScoreFunction


def test_one_rate_is_that_of_the_optimizer(tmp_path):
    population = make_population(perception_rate=0.07)
    perception, action = population.configure_optimizers()[0]
    assert perception.param_groups[0]["lr"] == 0.07
    assert action.param_groups[0]["lr"] == 0.03
    agent = population.member(3)
    assert [o.param_groups[0]["lr"] for o in agent.configure_optimizers()[0]] == [0.07, 0.03]


def test_settings_are_walked_through_side_by_side_or_combined():
    def settings(**own):
        return [(s.seed, *s.prices, s.perception_rate) for s in make_population(**own).settings]

    assert settings(perception_rate=[0.1, 0.2]) == [
        (3, 8.0, 10.0, 0.1),
        (4, 8.0, 10.0, 0.1),
        (3, 1.0, 10.0, 0.2),
        (4, 1.0, 10.0, 0.2),
    ]
    assert settings(perception_rate=[0.1, 0.2], grid=True, replicas=1) == [
        (3, 8.0, 10.0, 0.1),
        (3, 8.0, 10.0, 0.2),
        (3, 1.0, 10.0, 0.1),
        (3, 1.0, 10.0, 0.2),
    ]
    assert len(make_population(beta_perception=2.0, replicas=5)) == 5


def test_the_state_has_a_leading_dimension():
    population = make_population(marginals=RunningMarginals(), update_rule=ScoreFunction())
    shapes = {name: tuple(tensor.shape) for name, tensor in population.state_dict().items()}
    agent = Agent(**SETTINGS | {"marginals": RunningMarginals(), "update_rule": ScoreFunction()})
    assert shapes == {n: (4, *tensor.shape) for n, tensor in agent.state_dict().items()}
    assert {name for name, _ in population.named_parameters()} == {
        name for name, _ in agent.named_parameters()
    }


def test_worlds_are_drawn_only_for_rules_that_look_at_them():
    assert make_population(update_rule=ScoreFunction()).world_seeds == [3, 4, 3, 4]
    assert make_population(update_rule=Projection()).world_seeds is None
    assert make_population(update_rule=ExactGradient()).world_seeds is None
    noisy = make_population(task=Sensor(), update_rule=Projection())
    assert noisy.world_seeds == [3, 4, 3, 4]


def test_the_best_member_answers(tmp_path):
    population = make_population()
    fit(population, tmp_path, 50)
    objectives = population.objectives()
    assert objectives.shape == (4,) and objectives.dtype == torch.float64
    best = population.best_agent()
    assert population.best_index() == objectives.argmax()
    assert best.evaluate().objective == pytest.approx(objectives.max().item(), abs=1e-6)
    assert population.evaluate() == best.evaluate()
    assert torch.equal(population.behaviour(), best.behaviour())
    setting = population.settings[objectives.argmax()]
    assert (best.seed, best.beta_perception) == (setting.seed, setting.beta_perception)
    assert best.updates == 50
    torch.manual_seed(0)
    percept, action = population.act(population.task.observations)
    torch.manual_seed(0)
    assert torch.equal(
        torch.stack(best.act(population.task.observations)), torch.stack([percept, action])
    )
    # Weights that change by hand are noticed.
    with torch.no_grad():
        population.action.eta[population.best_index()] = 0.0
    assert population.objectives().max() < objectives.max()


class Interrupted(pl.Callback):
    """Looks at everything, which must not change training."""

    def on_train_batch_end(self, trainer, population, *_):
        if population.updates % 5 == 0:
            population.best_agent()
            population.evaluate()
            torch.rand(3)


@pytest.mark.parametrize(
    "own",
    [
        {"update_rule": ScoreFunction(2, "running"), "marginals": RunningMarginals()},
        {"perception_rate": [0.01, 0.1], "cooling": Cooling(4, 20)},
        {"perception": Dropping},
    ],
    ids=["buffers", "rates", "turns"],
)
def test_a_resumed_run_ends_where_the_uninterrupted_one_does(tmp_path, own):
    through = make_population(**own)
    fit(through, tmp_path, 10, max_epochs=3)
    callback = ModelCheckpoint(tmp_path, "cut", every_n_train_steps=13)
    cut_run = {"callbacks": [callback, Interrupted()], "enable_checkpointing": True}
    fit(make_population(**own), tmp_path, 10, max_epochs=3, max_steps=13, **cut_run)
    torch.manual_seed(99)
    resumed = make_population(**own | {"seed": 7})
    fit(resumed, tmp_path, 10, max_epochs=3, ckpt_path=tmp_path / "cut.ckpt")
    assert resumed.settings == through.settings
    assert (resumed.updates, resumed.samples) == (30, 120)
    ours, theirs = resumed.state_dict(), through.state_dict()
    assert all(torch.equal(ours[name], theirs[name]) for name in theirs)


def test_a_checkpoint_rebuilds_the_population_and_its_best_member(tmp_path):
    population = make_population(perception_rate=[0.01, 0.003], grid=True)
    path = tmp_path / "population.ckpt"
    fit(population, tmp_path, 20).save_checkpoint(path)
    loaded = Population.load_from_checkpoint(path)
    assert loaded.settings == population.settings
    assert torch.equal(loaded.objectives(), population.objectives())
    assert loaded.updates == 20
    agent = Agent.load_from_checkpoint(path)
    assert agent.evaluate() == population.evaluate()
    assert agent.seed == population.settings[population.best_index()].seed
    assert (agent.updates, agent.samples) == (20, 80)
    one = tmp_path / "agent.ckpt"
    fit(agent, tmp_path, 5).save_checkpoint(one)
    with pytest.raises(ValueError, match=r"holds one agent.*use Agent.load_from_checkpoint"):
        Population.load_from_checkpoint(one)
    with pytest.raises(ValueError, match="a population of 8, this run trains a population of 4"):
        fit(make_population(), tmp_path, 5, ckpt_path=path)
    with pytest.raises(ValueError, match="a population of 8, this run trains one agent"):
        fit(alone(population, 0), tmp_path, 5, ckpt_path=path)


class Normalising(torch.optim.SGD):
    """Scales the gradient by its norm over all parameters."""

    def step(self, closure=None):
        for group in self.param_groups:
            torch.nn.utils.clip_grad_norm_(group["params"], 0.1)
        super().step(closure)


class Capped(torch.optim.SGD):
    """Never goes faster than 0.05."""

    def step(self, closure=None):
        for group in self.param_groups:
            group["lr"] = min(group["lr"], 0.05)
        super().step(closure)


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ({"replicas": 0}, "replicas must be a whole number of at least 1, got 0"),
        (
            {"perception_rate": [0.1, 0.2, 0.3]},
            "beta_perception has 2, perception_rate has 3; grid=true takes all combinations",
        ),
        ({"beta_action": []}, "beta_action must hold at least one number"),
        ({"beta_action": [1.0, -1.0]}, "beta_action must be positive and finite, got -1"),
        ({"action_rate": [0.1, 0.0]}, "action_rate must be positive and finite, got 0"),
        ({"perception_optimizer": torch.optim.LBFGS}, "perception_optimizer: LBFGS"),
        ({"action_optimizer": Normalising}, "action_optimizer: Normalising does not treat each"),
        (
            {"action_optimizer": Capped, "action_rate": [0.1, 0.2]},
            "Capped.*its step is not proportional to its learning rate",
        ),
        ({"action_optimizer": torch.optim.Adafactor}, "Adafactor does not treat each parameter"),
    ],
)
def test_wrong_settings_are_refused(own, message):
    with pytest.raises(ValueError, match=message):
        make_population(**own)


@pytest.mark.parametrize("index", [-1, 4, 0.5, True])
def test_members_are_counted_from_0(index):
    with pytest.raises(IndexError, match=f"member must be between 0 and 3, got {index}"):
        make_population().member(index)


def test_members_that_run_away_are_named(tmp_path):
    population = make_population(
        perception_optimizer=torch.optim.SGD,
        perception_rate=[1e36, 0.1],
        update_rule=ScoreFunction(),
    )
    with pytest.raises(
        FloatingPointError,
        match=r"update \d+ for 2 of 4 members, the first with seed 3, .*perception_rate 1e\+36",
    ):
        fit(population, tmp_path, 20)


class Recording(ScoreFunction):
    """Keeps what it draws."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("numbers", torch.zeros(3))
        self.register_buffer("states", torch.zeros(4))

    def loss(self, chain, world):
        self.numbers.copy_(chain.uniform((3,)))
        self.states.copy_(world.state)
        return super().loss(chain, world)


def test_members_draw_what_agents_draw_bit_by_bit(tmp_path):
    population = make_population(update_rule=Recording())
    fit(population, tmp_path, 5)
    for index in range(len(population)):
        agent = alone(population, index, update_rule=Recording())
        fit(agent, tmp_path, 5)
        for name in ("numbers", "states"):
            ours = getattr(population.update_rule, name)[index]
            assert torch.equal(ours, getattr(agent.update_rule, name))


def test_updates_leave_default_generators_alone():
    population = make_population(update_rule=ScoreFunction(2))
    worlds = WorldStream(population.task, 4, population.world_seeds, "world")
    before = torch.get_rng_state()
    population.find_gradient(worlds[0])
    assert torch.equal(before, torch.get_rng_state())


def test_loss_scaling_is_refused(monkeypatch):
    population = make_population()
    scaling = SimpleNamespace(scaler=object())
    trainer = SimpleNamespace(precision_plugin=scaling, datamodule=None, is_global_zero=True)
    monkeypatch.setattr(Population, "trainer", trainer)
    with pytest.raises(ValueError, match="precision bf16-mixed or 32-true"):
        population.on_fit_start()
