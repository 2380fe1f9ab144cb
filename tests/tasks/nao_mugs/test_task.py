"""NaoMugs: frames, jitter, rewards, and what is refused."""

import copy
import pickle
import sys

import numpy as np
import pytest
import torch

from bra.checkpoints.recipes import from_recipe, to_recipe
from bra.randomness.draws import Streams
from bra.tasks import NaoMugs, RolloutDataModule
from bra.tasks.nao_mugs.task import UTILITIES

JITTERED = {"position_jitter": 0.01, "angle_jitter": 10.0, "light_jitter": 0.3}
EXPECTED = torch.tensor([[1, 0, 0, 0], [1, 1, 0, 1], [1, 0, 1, 1], [1, 1, 1, 1]], dtype=torch.bool)


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


@pytest.fixture(scope="module")
def jittered():
    return NaoMugs(**JITTERED)


def test_without_jitter_every_mug_has_one_frame():
    task = NaoMugs()
    assert task.noiseless
    assert task.utilities.tolist() == [list(row) for row in UTILITIES]
    assert task.prior.tolist() == [0.25] * 4
    assert task.state_names == ("m0", "mL", "mR", "m2")
    assert task.action_names == ("a0", "aL", "aR", "a2")
    world = task.states()
    assert world.observation.shape == (4, 1, 12, 16)
    assert world.observation.dtype == torch.float32
    assert all(task.observation_space.contains(frame) for frame in world.observation.numpy())
    distances = torch.cdist(world.observation.flatten(1), world.observation.flatten(1))
    assert distances[~torch.eye(4, dtype=torch.bool)].min() > 0.5
    drawn = task.sample(100, generator())
    assert torch.equal(drawn.observation, world.observation[drawn.state])


def test_jittered_frames_differ_and_repeat(jittered):
    assert not jittered.noiseless
    world = jittered.sample(24, generator())
    again = NaoMugs(**JITTERED).sample(24, generator())
    assert torch.equal(world.observation, again.observation)
    assert len({frame.numpy().tobytes() for frame in world.observation}) == 24
    assert all(jittered.observation_space.contains(frame) for frame in world.observation.numpy())
    other = jittered.sample(24, generator(1))
    assert not torch.equal(world.observation, other.observation)


def test_frames_do_not_depend_on_what_was_rendered_before(jittered):
    states = torch.arange(4)
    first = jittered.observe(states, generator(5))
    jittered.sample(10, generator(6))
    assert torch.equal(jittered.observe(states, generator(5)), first)


def test_a_bank_is_drawn_from_and_measured_without():
    task = NaoMugs(**JITTERED, bank=5)
    assert not task.noiseless
    drawn = task.sample(400, generator())
    frames = {frame.numpy().tobytes() for frame in drawn.observation}
    assert len(frames) == 20  # each is missed with probability 0.95⁴⁰⁰ = 1e-9
    fresh = task.observe(torch.arange(4), generator())
    assert not frames & {frame.numpy().tobytes() for frame in fresh}
    again = NaoMugs(**JITTERED, bank=5).sample(400, generator())
    assert torch.equal(drawn.observation, again.observation)


@pytest.mark.parametrize("own", [{}, JITTERED | {"bank": 5, "contrast": True}])
def test_streams_are_drawn_in_one_go_and_alone(own):
    task = NaoMugs(**own, prior=[0.1, 0.2, 0.3, 0.4])
    together = task.sample_streams(300, Streams([3, 4], "world"), update=7)
    for index, seed in enumerate((3, 4)):
        alone = task.sample_streams(300, Streams([seed], "world"), update=7)
        for ours, theirs in zip(together, alone, strict=True):
            assert torch.equal(ours[index], theirs[0])
    assert not torch.equal(together.state[0], together.state[1])
    # 600 draws: five standard errors, failure probability 2e-6.
    shares = together.state.flatten().bincount() / 600
    assert shares.tolist() == pytest.approx([0.1, 0.2, 0.3, 0.4], abs=0.1)
    frames = {frame.numpy().tobytes() for frame in together.observation.flatten(0, 1)}
    assert len(frames) == (20 if own else 4)  # a frame of m0 is missed with 0.98⁶⁰⁰ = 5e-6


def test_noise_on_the_usual_frames():
    task, usual = NaoMugs(pixel_noise=0.05), NaoMugs().states().observation
    assert not task.noiseless
    frames = task.observe(torch.arange(4).repeat(50), generator())
    assert all(task.observation_space.contains(frame) for frame in frames.numpy())
    difference = (frames - usual.repeat(50, 1, 1, 1)).std()
    # 38 400 pixels, the darkest clipped a little: the standard error is 2e-4.
    assert difference == pytest.approx(0.05, abs=2e-3)


def test_contrast_is_measured_against_the_mean_of_the_frame():
    task, grey = NaoMugs(contrast=True), NaoMugs().states().observation
    seen = task.states().observation
    assert all(task.observation_space.contains(frame) for frame in seen.numpy())
    mean = grey.mean((2, 3), keepdim=True)
    torch.testing.assert_close(seen, ((grey - mean) / mean).clamp(-1, 1))
    torch.testing.assert_close(task.signal(0.3 * grey), seen)  # the strength of light cancels
    assert torch.equal(task.signal(torch.zeros(1, 12, 16)), torch.full((1, 12, 16), -1.0))
    spot = torch.zeros(1, 12, 16)
    spot[0, 3, 4] = 1.0  # 191 times its frame's mean
    assert task.signal(spot).max() == 1.0


@pytest.mark.parametrize("own", [{"bank": 5}, {"pixel_noise": 0.05}, {}])
def test_contrast_of_frames_that_vary(own):
    given = JITTERED | own
    sees_grey, sees_contrast = NaoMugs(**given), NaoMugs(**given, contrast=True)
    grey, seen = (task.sample(6, generator()) for task in (sees_grey, sees_contrast))
    assert torch.equal(grey.state, seen.state)
    torch.testing.assert_close(seen.observation, sees_contrast.signal(grey.observation))
    assert all(
        sees_contrast.observation_space.contains(frame) for frame in seen.observation.numpy()
    )


def test_size_of_frames():
    task = NaoMugs(width=20, height=10, supersampling=2)
    assert task.observation_space.shape == (1, 10, 20)
    assert task.states().observation.shape == (4, 1, 10, 20)


def test_the_simulation_stays_in_its_process(jittered):
    jittered.sample(1, generator())
    for copied in (pickle.loads(pickle.dumps(jittered)), copy.deepcopy(jittered)):
        world, same = jittered.sample(4, generator(3)), copied.sample(4, generator(3))
        assert torch.equal(world.observation, same.observation)


@pytest.mark.parametrize("arguments", [{}, JITTERED, {"prior": [0.1, 0.2, 0.3, 0.4], "width": 8}])
def test_recipe(arguments):
    task = NaoMugs(**arguments)
    rebuilt = from_recipe(to_recipe(task))
    world, same = task.sample(6, generator()), rebuilt.sample(6, generator())
    assert torch.equal(world.state, same.state)
    assert torch.equal(world.observation, same.observation)


def test_two_workers_draw_what_one_process_draws(jittered):
    streams = [
        list(
            RolloutDataModule(jittered, 5, updates_per_epoch=4, workers=workers).train_dataloader()
        )
        for workers in (0, 2)
    ]
    for left, right in zip(*streams, strict=True):
        assert torch.equal(left.state, right.state)
        assert torch.equal(left.observation, right.observation)


@pytest.fixture(scope="module")
def executed():
    return NaoMugs(torch.arange(1.0, 17).reshape(4, 4).tolist(), reward="physics")


def test_reward_of_executed_lifts(executed):
    table, task = torch.arange(1.0, 17).reshape(4, 4), executed
    assert torch.equal(task.successes, EXPECTED.unsqueeze(-1))
    expected = table * EXPECTED
    assert torch.equal(task.utilities.float(), expected)
    states, actions = torch.arange(4).repeat_interleave(4), torch.arange(4).repeat(4)
    assert torch.equal(task.utility(states, actions), expected.flatten())


def test_reward_of_one_of_several_executed_lifts(executed):
    task = copy.copy(executed)
    task.successes = torch.zeros(4, 4, 4, dtype=torch.bool)
    task.successes[1, 1, 0] = True  # one pose in four
    torch.manual_seed(0)
    worth = task.utility(torch.ones(4000, dtype=torch.long), torch.ones(4000, dtype=torch.long))
    assert set(worth.tolist()) == {0.0, 6.0}
    # 4000 draws of probability ¼: six standard errors, failure probability 2e-9.
    assert (worth > 0).float().mean() == pytest.approx(0.25, abs=0.041)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"utilities": np.eye(3)},
            r"utilities must be a table of 4 mugs and 4 actions, got \(3, 3",
        ),
        ({"width": 0}, r"width must be .*got 0"),
        ({"height": -3}, r"height must be .*got -3"),
        ({"width": 100_000}, r"at most 2048 pixels .* got 100000 × 12 with supersampling 1"),
        ({"width": 640, "supersampling": 4}, r"at most 2048 pixels .* got 640 × 12"),
        ({"supersampling": 0}, r"supersampling must be .*got 0"),
        ({"position_jitter": -0.1}, r"position_jitter must be at least 0, got -0\.1"),
        (
            {"position_jitter": 0.2},
            r"position_jitter 0\.2 m and .* out of reach: the hands do not reach",
        ),
        ({"angle_jitter": 90}, r"angle_jitter 90° put the mug out of reach: .*yaw"),
        ({"light_jitter": 1.0}, r"light_jitter must be less than 1, got 1\.0"),
        ({"bank": -1}, r"bank must be a whole number of at least 0, got -1"),
        ({"pixel_noise": float("nan")}, r"pixel_noise must be at least 0, got nan"),
        ({"reward": "fame"}, r"reward must be table or physics, got 'fame'"),
        ({"prior": [1, 1]}, r"prior"),
        ({"robot": "nowhere.urdf"}, r"nowhere\.urdf"),
    ],
)
def test_refusals(arguments, message):
    with pytest.raises(ValueError, match=message) as caught:
        NaoMugs(**arguments)
    assert "\n" not in str(caught.value)


def test_without_pybullet(monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(ImportError, match="NaoMugs needs pybullet, which cannot be imported"):
        NaoMugs()
