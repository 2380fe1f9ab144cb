"""What agents, data and schedules refuse in one line; and what they take."""

from functools import partial

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete
from torch.optim import SGD, Adam, lr_scheduler
from torch.utils.data import DataLoader, TensorDataset
from training import fit, make_trainer

from bra import Agent, Cooling, Population, PredatorPrey, RolloutDataModule, TableTask
from bra.marginals import BatchMarginals
from bra.tasks import Task, World, WorldError
from bra.update_rules import ScoreFunction

HUNT = PredatorPrey()
MADE = "must be made, got the class"
COUNT = "must be a whole number of at least"


@pytest.mark.parametrize(
    ("own", "said"),
    [
        ({"task": None}, "task must be of class Task, got None"),
        ({"task": PredatorPrey}, f"task {MADE}; pass PredatorPrey"),
        ({"task": np.eye(2)}, "task must be of class Task, got array"),
        ({"cooling": 3.0}, "cooling must be of class Cooling, got 3.0"),
        ({"cooling": Cooling}, f"cooling {MADE}"),
        ({"update_rule": "ScoreFunction"}, "update_rule must be of class UpdateRule"),
        ({"update_rule": ScoreFunction}, f"update_rule {MADE}"),
        ({"marginals": BatchMarginals}, f"marginals {MADE}"),
        ({"perception": "MLP"}, "perception must be a class of kind Channel, .* got 'MLP'"),
        (
            {"perception_optimizer": "Adam"},
            "perception_optimizer must be a class of kind Optimizer",
        ),
        (
            {"action_optimizer": SGD([torch.zeros(1)])},
            "action_optimizer must be a class of kind Optimizer",
        ),
        ({"action_scheduler": "StepLR"}, "action_scheduler must be a class of kind LRScheduler"),
        ({"action_scheduler": lr_scheduler.StepLR}, "action_scheduler: .* missing 1 required"),
        ({"perception_optimizer": partial(Adam, lr=np.nan)}, "perception_optimizer: "),
        ({"action_optimizer": partial(Adam, lr=np.inf)}, "action_optimizer: lr must be finite"),
        ({"action_optimizer": partial(SGD, lr=-1.0)}, "action_optimizer: Invalid learning rate"),
        ({"seed": -3}, f"seed {COUNT} 0, got -3"),
        ({"seed": 1.5}, f"seed {COUNT} 0, got 1.5"),
        ({"seed": True}, f"seed {COUNT} 0, got True"),
        ({"percepts": 10**12}, "perception: no memory holds this channel"),
    ],
)
def test_agents_refuse(own, said):
    with pytest.raises((TypeError, ValueError), match=said):
        Agent(**{"task": HUNT, "percepts": 2} | own)


@pytest.mark.parametrize(
    ("own", "said"),
    [
        ({"seed": -3}, f"seed {COUNT} 0, got -3"),
        ({"beta_perception": "ab"}, "beta_perception must be positive and finite, got 'a'"),
        ({"beta_action": [1.0, None]}, "beta_action must be positive and finite, got None"),
        ({"perception_rate": ["a"]}, "perception_rate must be positive and finite, got 'a'"),
        ({"action_rate": 0}, "action_rate must be positive and finite, got 0"),
    ],
)
def test_populations_refuse(own, said):
    with pytest.raises(ValueError, match=said):
        Population(HUNT, 2, percepts=2, **own)


@pytest.mark.parametrize(
    ("schedule", "own", "said"),
    [
        ("StepLR", {"step_size": 0}, f"step_size {COUNT} 1, got 0"),
        ("StepLR", {"step_size": -1}, f"step_size {COUNT} 1, got -1"),
        ("CosineAnnealingLR", {"T_max": 0}, f"T_max {COUNT} 1, got 0"),
        ("LinearLR", {"total_iters": 0}, f"total_iters {COUNT} 1, got 0"),
        ("OneCycleLR", {"max_lr": 0.1, "total_steps": 0}, f"total_steps {COUNT} 1, got 0"),
        ("ExponentialLR", {"gamma": -1.0}, "gamma must be finite and at least 0, got -1.0"),
        ("ExponentialLR", {"gamma": np.nan}, "gamma must be finite and at least 0, got nan"),
        ("ReduceLROnPlateau", {}, "ReduceLROnPlateau waits for a metric"),
    ],
)
def test_schedules_refuse(schedule, own, said):
    factory = partial(getattr(lr_scheduler, schedule), **own)
    with pytest.raises(ValueError, match=f"^action_scheduler: {said}"):
        Agent(HUNT, percepts=2, action_scheduler=factory)


@pytest.mark.parametrize("factor", [None, "4", [None, 2], torch.tensor(4.0), np.array([1.0, 4.0])])
def test_factors_are_numbers(factor):
    with pytest.raises(ValueError, match="cooling factor must be positive and finite, got"):
        Cooling(factor)


def test_a_rate_of_0_keeps_a_channel_and_says_so(tmp_path, capsys):
    agent = Agent(HUNT, percepts=2, seed=0, perception_optimizer=partial(SGD, lr=0.0))
    before = [parameter.clone() for parameter in agent.perception.parameters()]
    fit(agent, tmp_path, max_epochs=1)
    assert all(map(torch.equal, before, agent.perception.parameters()))
    assert "note: perception_optimizer has a learning rate of 0" in capsys.readouterr().out


INDEXED = Agent(TableTask(torch.eye(3), observations="index"), seed=0)
SEEING = Agent(TableTask(torch.eye(2), observations=[[[0.0, 1.0]], [[1.0, 0.0]]]), seed=0)


@pytest.mark.parametrize(
    ("agent", "observation", "shape"),
    [
        (INDEXED, 1, ()),
        (INDEXED, [0, 2], (2,)),
        (INDEXED, np.array([[0, 1]], dtype=np.uint8), (1, 2)),
        (SEEING, [[0.0, 1.0]], ()),
        (SEEING, np.zeros((3, 1, 2), dtype=">f4"), (3,)),
        (SEEING, torch.zeros(4, 3, 1, 2, dtype=torch.double), (4, 3)),
        (SEEING, torch.zeros(0, 1, 2), (0,)),
    ],
)
def test_signals_of_any_kind_are_acted_on(agent, observation, shape):
    percept, action = agent.act(observation)
    assert percept.shape == action.shape == shape


@pytest.mark.parametrize(
    ("agent", "observation", "said"),
    [
        (INDEXED, -1, r"observation must be of Discrete\(3\), got -1"),
        (INDEXED, [0, 3], "got 3"),
        (INDEXED, 0.5, "got 0.5"),
        (INDEXED, float("nan"), "got nan"),
        (INDEXED, None, "got None"),
        (SEEING, [[0.0, np.nan]], r"observation must be of Box\(.*\) and finite, got nan"),
        (SEEING, torch.full((1, 2), torch.inf), "and finite, got inf"),
        (SEEING, torch.zeros(2, 1), r"got shape \(2, 1\), which does not end in it"),
        (SEEING, 0.0, r"got shape \(\)"),
        (SEEING, [["a", "b"]], "got .*a"),
    ],
)
def test_what_is_no_signal_is_refused(agent, observation, said):
    with pytest.raises(ValueError, match=said):
        agent.act(observation)


def test_bytes_are_scaled_as_channels_say():
    states = torch.arange(2)
    images = torch.tensor([[[0, 255]], [[255, 0]]], dtype=torch.uint8)
    torch.manual_seed(0)
    expected = SEEING.act(images / 255)
    torch.manual_seed(0)
    found = SEEING.act(images)
    assert all(map(torch.equal, expected, found)) and len(found[0]) == len(states)


@pytest.mark.parametrize("path", [None, 3])
def test_a_path_is_a_path(path):
    with pytest.raises(TypeError, match=f"path of a checkpoint must be .* got {path}"):
        Agent.load_from_checkpoint(path)


LOADERS = [
    DataLoader(torch.zeros(4, 4)),
    DataLoader(TensorDataset(torch.zeros(4), torch.zeros(4, 4))),
    DataLoader([{"x": 1}]),
]


@pytest.mark.parametrize("loader", LOADERS)
def test_batches_of_anything_else_are_refused(tmp_path, loader):
    with pytest.raises(WorldError, match=r"agents learn from batches bra\.World"):
        make_trainer(tmp_path, max_epochs=1).fit(Agent(HUNT, seed=0), loader)


def test_a_fit_needs_data(tmp_path):
    with pytest.raises(Exception, match=r"no worlds to learn from; call trainer\.fit"):
        make_trainer(tmp_path, max_epochs=1).fit(Agent(HUNT, seed=0))


@pytest.mark.parametrize("task", [None, PredatorPrey])
def test_data_needs_a_task(task):
    with pytest.raises(TypeError, match="task must be"):
        RolloutDataModule(task)


class Broken(Task):
    """Keeps one promise less."""

    observation_space, action_space = Box(0.0, 1.0, (2,)), Discrete(2)

    def __init__(self, how):
        self.how = how

    def sample(self, count, generator):
        signals = torch.rand(count, 2, generator=generator)
        state = torch.zeros(count)
        match self.how:
            case "few":
                state, signals = state[1:], signals[1:]
            case "fewer signals":
                signals = signals[1:]
            case "shape":
                signals = torch.zeros(count, 3)
            case "nan":
                signals[0] = torch.nan
            case "numpy":
                signals = signals.numpy()
            case "tuple":
                return state, signals
        return World(state, signals)

    def utility(self, state, action):
        match self.how:
            case "list":
                return [0.0] * len(action)
            case "column":
                return torch.zeros(len(action), 1)
            case "no number":
                return torch.full(action.shape, torch.nan)
        return torch.zeros(action.shape)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("few", r"sample returned state of shape \(1,\); of 2 worlds it must begin with 2"),
        ("fewer signals", r"sample returned observation of shape \(1, 2\)"),
        ("shape", r"sample returned signals of shape \(3,\); Box.* asks for \(2,\)"),
        ("nan", "sample returned signals that are not finite"),
        ("numpy", "sample returned observation as ndarray; expected a tensor"),
        ("tuple", r"sample returned tuple; expected bra.World"),
        ("list", "utility returned list; expected a tensor"),
        ("column", r"utility returned shape \(2, 1\) for 2 states and 2 actions; expected \(2,\)"),
        ("no number", "utility returned NaN for action 0"),
    ],
)
def test_tasks_that_break_their_promise_are_told_at_the_start(tmp_path, how, said):
    agent = Agent(Broken(how), percepts=2, seed=0, update_rule=ScoreFunction())
    with pytest.raises(WorldError, match=f"^Broken.{said}"):
        fit(agent, tmp_path, max_epochs=1)
    assert agent.updates == 0
