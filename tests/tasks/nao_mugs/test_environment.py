"""The Gymnasium environment."""

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils.env_checker import check_env

from bra.tasks.nao_mugs import Light, Pose
from bra.tasks.nao_mugs.environment import NaoMugsEnv

JITTERED = {"position_jitter": 0.01, "angle_jitter": 10.0, "light_jitter": 0.3, "pixel_noise": 0.02}


@pytest.fixture
def env():
    env = NaoMugsEnv()
    yield env
    env.close()


@pytest.mark.filterwarnings("ignore:.*render.*")
def test_passes_the_checker():
    # Rendering in a window needs a display; the pictures have a test of their own.
    env = gymnasium.make("bra/NaoMugs-v0", **JITTERED)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_an_agent_of_contrast_is_shown_contrast():
    grey, contrast = (NaoMugsEnv(contrast=value) for value in (False, True))
    frames, seen = ([env.reset(seed=3)[0], env.step(1)[0]] for env in (grey, contrast))
    for frame, signal in zip(frames, seen, strict=True):
        assert contrast.observation_space.contains(signal)
        mean = frame.mean()
        np.testing.assert_allclose(signal, (frame / mean - 1).clip(-1, 1), atol=1e-5)
    grey.close()
    contrast.close()


def episodes(seed, actions=(1, 3)):
    env = gymnasium.make("bra/NaoMugs-v0", **JITTERED)
    trace = []
    for number, action in enumerate(actions):
        frame, seen = env.reset(seed=seed if number == 0 else None)
        after, reward, terminated, truncated, info = env.step(action)
        assert terminated and not truncated
        trace.append((frame.tobytes(), seen, after.tobytes(), reward, info))
    env.close()
    return trace


def test_same_seed_same_pixels_same_outcome():
    first = episodes(0)
    assert first == episodes(0)
    assert first[0][1] != first[1][1]
    assert episodes(1, actions=(0,))[0][:2] != first[0][:2]


@pytest.mark.parametrize(
    ("mug", "action", "reward", "success"),
    [("m0", 0, 5.0, False), ("m0", 1, 0.0, False), ("mL", 1, 5.0, True), (3, 3, 5.0, True)],
)
def test_reward_and_outcome(env, mug, action, reward, success):
    frame, seen = env.reset(options={"mug": mug, "pose": (0.172, -0.004, 0.05)})
    assert env.observation_space.contains(frame)
    assert seen["mug"] == (mug if isinstance(mug, str) else "m2")
    assert seen["pose"] == (0.172, -0.004, 0.05)
    after, earned, terminated, _, info = env.step(action)
    assert (earned, terminated, info["success"]) == (reward, True, success)
    assert (info["rise"] > 0.05) is success
    assert env.observation_space.contains(after)
    if action == 0:
        assert np.abs(after - frame).mean() < 0.01


def test_reward_of_success_only():
    env = NaoMugsEnv(reward="physics", utilities=np.full((4, 4), 7.0))
    env.reset(options={"mug": "mL"})
    assert env.step(2)[1] == 0.0  # nothing there for the right hand
    env.reset(options={"mug": "mL"})
    assert env.step(0)[1] == 7.0  # nothing to fail in not lifting
    env.close()


def test_options_do_not_change_later_episodes():
    mugs = []
    for options in (None, {"mug": "m0", "pose": Pose(), "light": Light(strength=0.8)}):
        env = NaoMugsEnv(**JITTERED)
        env.reset(seed=3, options=options)
        mugs.append([env.reset()[1] for _ in range(3)])
        env.close()
    assert mugs[0] == mugs[1]


def test_light_is_seen(env):
    options = {"mug": "m2", "pose": Pose()}
    usual, _ = env.reset(options=options)
    dim, seen = env.reset(options={**options, "light": Light(strength=0.5)})
    assert seen["light"] == Light(strength=0.5)
    assert dim.mean() < 0.7 * usual.mean()
    assert np.array_equal(env.reset(options=options)[0], usual)


def test_pictures_from_outside():
    env = NaoMugsEnv("rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (480, 640, 3) and picture.dtype == np.uint8
    assert np.ptp(picture) > 150
    env.close()


def test_stepping_without_reset(env):
    with pytest.raises(ResetNeeded, match=r"call reset\(\) before each step"):
        env.step(0)
    env.reset()
    env.step(0)
    with pytest.raises(ResetNeeded, match=r"call reset\(\) before each step"):
        env.step(0)


def test_a_closed_environment_says_so():
    env = NaoMugsEnv()
    env.reset()
    env.close()
    env.close()
    with pytest.raises(ResetNeeded):
        env.step(0)
    with pytest.raises(ClosedEnvironmentError, match="closed; make a new one"):
        env.reset()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mug": "m7"}, "mug must be one of m0, mL, mR, m2 or 0 to 3, got 'm7'"),
        ({"mug": 4}, "mug must be one of .* got 4"),
        ({"mug": -1}, "mug must be one of .* got -1"),
        ({"pose": (0.5, 0, 0)}, "the hands do not reach a mug at x 0.5 m"),
        ({"pose": (0.17, 0)}, "pose must be x, y .* got"),
        ({"light": 3}, "light must be"),
        ({"mug": True}, "mug must be one of .* got True"),
        ({"pose": (0.17, 0, "a")}, "pose must be x, y .* got"),
        ({3: 1}, r"unknown options \['3'\]"),
        ({"cup": 1}, r"unknown options \['cup'\]; expected mug, pose, light"),
    ],
)
def test_refused_options(env, options, message):
    with pytest.raises(ValueError, match=message) as caught:
        env.reset(options=options)
    assert "\n" not in str(caught.value)


def test_refused_actions(env):
    env.reset()
    with pytest.raises(ValueError, match="action must be 0, 1, 2 or 3, got 4"):
        env.step(4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"direction": (0, 0, 0)}, "direction must be three numbers, not all 0"),
        ({"direction": (0, 1)}, "direction must be three numbers"),
        ({"diffuse": -1.0}, "the light's diffuse must be at least 0, got -1.0"),
        ({"strength": float("nan")}, "the light's strength must be at least 0, got nan"),
    ],
)
def test_refused_light(arguments, message):
    # Bullet would keep what it was told before.
    with pytest.raises(ValueError, match=message):
        Light(**arguments)


def test_refused_windows(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(RuntimeError, match="no display for the window"):
        NaoMugsEnv("human")
    monkeypatch.setenv("DISPLAY", ":7777")  # where no server answers
    with pytest.raises(RuntimeError, match="no display for the window"):
        NaoMugsEnv("human")
    with pytest.raises(ValueError, match="render_mode must be rgb_array, human or None, got 'mp4'"):
        NaoMugsEnv("mp4")
