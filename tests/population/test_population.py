"""A member of a population goes the way that an agent goes alone."""

import math
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import lightning.pytorch as pl
import pytest
import torch
from gymnasium.spaces import Box, Discrete
from lightning.pytorch.callbacks import ModelCheckpoint
from torch.distributions import Categorical
from torch.optim.lr_scheduler import ExponentialLR

from bra import Agent, Cooling, Population, PredatorPrey, RolloutDataModule, TableTask
from bra.channels import CNN, MLP, Channel, Gaussian, Multinomial, Table
from bra.critics import Exploration, NetworkCritic, TableCritic
from bra.marginals import BatchMarginals, ExactMarginals, RunningMarginals
from bra.tasks import FiniteTask, Medical, TargetTask, Task, World
from bra.tasks.datamodule import WorldStream
from bra.update_rules import ExactGradient, Projection, Rivals, ScoreFunction

SEED = 3


@pytest.fixture
def double():
    """Float64, so that rounding tips no draw."""
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


def fit(learner, folder: Path, updates=200, batch_size=4, ckpt_path=None, **trainer) -> pl.Trainer:
    settings = {
        "max_epochs": 1,
        "accelerator": "cpu",
        "logger": False,
        "enable_checkpointing": False,
        "enable_progress_bar": False,
        "enable_model_summary": False,
        "default_root_dir": folder,
    }
    trainer = pl.Trainer(**(settings | trainer))
    data = RolloutDataModule(learner.task, batch_size, updates)
    trainer.fit(learner, data, ckpt_path=ckpt_path, weights_only=True)
    return trainer


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


def assert_close(member: Agent, agent: Agent, atol: float) -> None:
    assert member.updates == agent.updates
    assert member.samples == agent.samples
    ours, theirs = member.state_dict(), agent.state_dict()
    assert ours.keys() == theirs.keys()
    for name, tensor in ours.items():
        torch.testing.assert_close(tensor, theirs[name], rtol=atol, atol=atol)


def assert_members_equal_agents(folder, updates=24, batch_size=4, atol=1e-9, varied=None, **own):
    population = make_population(**(varied or {}), **own)
    fit(population, folder, updates, batch_size)
    for index in range(len(population)):
        agent = alone(population, index, **own)
        fit(agent, folder, updates, batch_size)
        assert_close(population.member(index), agent, atol)
        judged = population.member(index).evaluate().objective
        assert population.objectives()[index].item() == pytest.approx(judged, abs=1e-6)


@pytest.mark.parametrize("rule", [Projection(), ExactGradient()], ids=["projection", "gradient"])
def test_without_draws_in_float32(tmp_path, rule):
    assert_members_equal_agents(
        # Rounding, which depends on the machine, is carried through the updates.
        tmp_path,
        atol=3e-4,
        update_rule=rule,
        cooling=Cooling(4, 12),
        batch_size=8,
    )


RULES = {
    "projection": Projection(),
    "rivals": Projection(rivals=Rivals(count=2, sweeps=4, lead=6)),
    "gradient": ExactGradient(),
    "online": ScoreFunction(),
    "running": ScoreFunction(samples=2, baseline="running"),
    "leave-one-out": ScoreFunction(samples=2, baseline="leave-one-out"),
}


@pytest.mark.parametrize("batch_size", [1, 4])
@pytest.mark.parametrize("rule", RULES)
def test_rules(tmp_path, double, rule, batch_size):
    assert_members_equal_agents(
        tmp_path, 24, batch_size, update_rule=RULES[rule], cooling=Cooling(4, 12)
    )


@pytest.mark.parametrize(
    "marginals", [ExactMarginals(), BatchMarginals(), RunningMarginals(0.9)], ids=repr
)
def test_marginals(tmp_path, double, marginals):
    assert_members_equal_agents(tmp_path, marginals=marginals, update_rule=ScoreFunction(2))


IMAGES = torch.rand(4, 1, 5, 3, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(
    ("perception", "action", "observations"),
    [
        (partial(CNN, channels=[2]), Table, IMAGES),
        (Table, partial(Multinomial, reference=2), "index"),
        (partial(MLP, hidden=[3, 3], activation=torch.nn.ReLU), MLP, "onehot"),
        (Multinomial, partial(Table, start="covering"), "index"),
    ],
    ids=["cnn-table", "table-multinomial", "mlp-mlp", "multinomial-table"],
)
@pytest.mark.parametrize("rule", ["projection", "leave-one-out"])
def test_channels(tmp_path, double, perception, action, observations, rule):
    task = TableTask([[1.0, 0, 0], [0, 2, 0], [0, 0, 3], [1, 1, 1]], None, observations)
    assert_members_equal_agents(
        tmp_path,
        60,
        task=task,
        perception=perception,
        action=action,
        percepts=3,
        update_rule=RULES[rule],
    )


class Sensor(FiniteTask):
    """Four states whose signals are noisy."""

    def __init__(self) -> None:
        super().__init__(torch.eye(4), observations=Box(-9, 9, (4,)))

    def observe(self, state, generator):
        noise = torch.randn((len(state), 4), generator=generator)
        return (torch.eye(4)[state] + 0.3 * noise).to(torch.get_default_dtype())


@pytest.mark.parametrize("rule", ["projection", "leave-one-out"])
def test_a_noisy_sensor(tmp_path, double, rule):
    assert_members_equal_agents(
        tmp_path, 60, task=Sensor(), percepts=4, update_rule=RULES[rule], batch_size=6
    )


class Dial(Task):
    """A world without a list of states: say whether a noisy reading of ω ~ N(0, 1) is positive."""

    observation_space = Box(-9, 9, (1,))
    action_space = Discrete(2)

    def sample(self, count, generator):
        state, noise = torch.randn((2, count), generator=generator)
        return World(state, (state + 0.1 * noise).unsqueeze(-1))

    def utility(self, state, action):
        return ((state > 0) == action.bool()).to(torch.get_default_dtype())


@pytest.mark.parametrize("rule", ["projection", "online"])
def test_a_world_without_a_list_of_states(tmp_path, double, rule):
    assert_members_equal_agents(tmp_path, 40, task=Dial(), percepts=3, update_rule=RULES[rule])


CRITICS = {
    "table": (TableCritic(start=5.0), SETTINGS["task"]),
    "network": (NetworkCritic(hidden=[6], start=2.5, memory=20, batch_size=5), SETTINGS["task"]),
    "noisy sensor": (NetworkCritic(hidden=[6], memory=20, batch_size=5, steps=2), Sensor()),
    "no states": (NetworkCritic(hidden=[6], memory=20, batch_size=5), Dial()),
}


@pytest.mark.parametrize("critic", CRITICS)
def test_critics(tmp_path, double, critic):
    made, task = CRITICS[critic]
    rule = Projection(critic=made, exploration=Exploration(0.3, 40, uniform_updates=10))
    assert_members_equal_agents(tmp_path, 60, task=task, update_rule=rule, batch_size=2)


def test_members_with_critics_are_one_batch(tmp_path, monkeypatch):
    made, task = CRITICS["noisy sensor"]
    rule = Projection(critic=made, exploration=Exploration(0.3, 40, uniform_updates=10))
    population = make_population(task=task, update_rule=rule)

    def in_turn(*_):
        raise AssertionError("members took turns")

    monkeypatch.setattr(population._stacked_loss, "_in_turn", in_turn)
    fit(population, tmp_path, 5)
    assert population.state_dict()["update_rule.critic.replay.written"].tolist() == [20] * 4


def test_members_go_the_ways_of_their_own_factors(tmp_path, double):
    cooling = Cooling(factor=[2.0, 16.0], updates=50, action_factor=[0.25, 4.0])
    assert_members_equal_agents(tmp_path, 60, cooling=cooling)
    members = make_population(cooling=cooling, replicas=3, beta_perception=8.0)
    scales = {members.member(index).prices[0] for index in range(3)}
    assert len(scales) == 3


@pytest.mark.parametrize("rule", ["projection", "leave-one-out"])
def test_specialists(tmp_path, double, rule):
    """Members whose actions look at the signal again, at a third price that cools too."""
    own = {"task": Medical(), "beta_direct": 0.9, "action": partial(MLP, hidden=[4])}
    cooling = Cooling(factor=[2.0, 16.0], updates=20)
    free = {"beta_action": [10.0, math.inf]}
    own |= {"update_rule": RULES[rule], "cooling": cooling}
    assert_members_equal_agents(tmp_path, 30, varied=free, **own)
    with pytest.raises(ValueError, match="beta_action must be positive and finite, got inf"):
        make_population(beta_action=[10.0, math.inf])


def test_densities_take_turns(tmp_path, double, monkeypatch):
    monkeypatch.setattr("bra.evaluation.tables.SUPPORT_SIZE", 64)
    assert_members_equal_agents(
        tmp_path,
        20,
        task=TargetTask([[0.0], [1.0]], observations="index"),
        perception=Gaussian,
        action=partial(MLP, hidden=[4]),
        percepts=Box(-3, 3, (2,)),
        update_rule=ScoreFunction(2),
    )


class Dropping(MLP):
    """A channel that is disturbed while it learns."""

    def forward(self, condition):
        if not self.training:
            return super().forward(condition)
        kept = torch.rand((), dtype=torch.get_default_dtype()) < 0.9
        logits = super().forward(condition).logits
        return Categorical(logits=torch.where(kept, logits, -logits), validate_args=False)


def test_channels_that_draw_take_turns(tmp_path, double):
    assert_members_equal_agents(tmp_path, 20, perception=Dropping, update_rule=Projection())


OPTIMIZERS = {
    "descent": partial(torch.optim.SGD, lr=0.1),
    "sgd": partial(torch.optim.SGD, lr=0.1, momentum=0.9, weight_decay=0.01),
    "adamw": partial(torch.optim.AdamW, lr=0.01),
    "rmsprop": partial(torch.optim.RMSprop, lr=0.01, momentum=0.5),
}


@pytest.mark.parametrize("optimizer", OPTIMIZERS)
def test_every_member_has_its_own_rates(tmp_path, double, optimizer):
    assert_members_equal_agents(
        tmp_path,
        100,
        varied={
            "replicas": 1,
            "beta_perception": [8.0, 1.0, 2.0],
            "perception_rate": [0.001, 0.01, 0.1],
            "action_rate": [0.1, 0.03, 0.02],
        },
        perception_optimizer=OPTIMIZERS[optimizer],
        action_optimizer=OPTIMIZERS[optimizer],
        perception_scheduler=partial(ExponentialLR, gamma=0.98),
        atol=1e-8,
    )


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


def test_tied_parameters_stay_tied(tmp_path, double):
    assert_members_equal_agents(tmp_path, 30, perception=Tied)


class Tied(Channel):
    """One matrix used twice."""

    def __init__(self, condition_space, outcome_space):
        super().__init__(condition_space, outcome_space)
        self.first = torch.nn.Linear(4, 4)
        self.second = torch.nn.Linear(4, 4)
        self.second.weight = self.first.weight
        self.last = torch.nn.Linear(4, int(outcome_space.n))

    def forward(self, condition):
        logits = self.last(self.second(self.first(condition.to(self.first.weight.dtype)).tanh()))
        return Categorical(logits=logits, validate_args=False)


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


class Halting(ScoreFunction):
    """Ties the perception channel's gradient to nothing."""

    def loss(self, chain, world):
        loss, terms = super().loss(chain, world)
        action_loss = -chain.action.forward_all().logits[:, 0].sum()
        return action_loss + 0.0 * loss.detach(), terms


def test_parameters_that_the_loss_knows_nothing_of_stay(tmp_path):
    decaying = partial(torch.optim.SGD, lr=0.1, weight_decay=0.1)
    assert_members_equal_agents(
        tmp_path, 5, update_rule=Halting(), perception_optimizer=decaying, atol=1e-6
    )


def test_loss_scaling_is_refused(monkeypatch):
    population = make_population()
    scaling = SimpleNamespace(scaler=object())
    trainer = SimpleNamespace(precision_plugin=scaling, datamodule=None, is_global_zero=True)
    monkeypatch.setattr(Population, "trainer", trainer)
    with pytest.raises(ValueError, match="precision bf16-mixed or 32-true"):
        population.on_fit_start()
