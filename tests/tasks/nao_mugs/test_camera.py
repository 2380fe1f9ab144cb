import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from bra.tasks import WorldError
from bra.tasks.nao_mugs.bullet import connect
from bra.tasks.nao_mugs.camera import FIELD_OF_VIEW, HEAD_AT_REST, Camera, Light, Studio
from bra.tasks.nao_mugs.furniture import furnish
from bra.tasks.nao_mugs.mugs import MUGS, Pose
from bra.tasks.nao_mugs.scene import Scene

LIGHTS = [Light(), Light(direction=(0.5, 0.3, 1.0), strength=0.8), Light(diffuse=0.2)]
POSES = [Pose(), Pose(0.16, -0.01, math.radians(-10)), Pose(0.18, 0.01, math.radians(10))]


@pytest.fixture(scope="module")
def studio():
    studio = Studio()
    yield studio
    studio.close()


@pytest.fixture(scope="module")
def scene():
    with Scene() as scene:
        yield scene


@pytest.mark.parametrize(
    ("width", "height", "supersampling"), [(16, 12, 1), (16, 12, 4), (8, 5, 3)]
)
def test_frames(width, height, supersampling):
    studio = Studio(Camera(width, height, supersampling))
    rgb, grey = studio.rgb(MUGS[3], Pose()), studio.grey(MUGS[3], Pose())
    assert (rgb.shape, rgb.dtype) == ((height, width, 3), np.uint8)
    assert (grey.shape, grey.dtype) == ((1, height, width), np.float32)
    assert 0.1 < grey.min() < 0.2  # the cup's shade
    assert 0.6 < grey.max() < 0.7  # the table
    luma = rgb @ np.array([0.299, 0.587, 0.114]) / 255
    assert grey[0] == pytest.approx(luma, abs=1e-6 if supersampling == 1 else 0.5 / 255)


def test_supersampling_averages_blocks():
    fine = Studio(Camera(64, 48)).grey(MUGS[2], Pose())
    coarse = Studio(Camera(16, 12, supersampling=4)).grey(MUGS[2], Pose())
    assert coarse == pytest.approx(fine.reshape(1, 12, 4, 16, 4).mean((2, 4)), abs=1e-6)


def test_field_of_view():
    """A ball at the edge of the field of view lies at the edge of the picture."""
    client, camera = connect(), Camera(160, 120)
    level = ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])
    for axis, angle in enumerate(FIELD_OF_VIEW):
        for inside, seen in ((-1.5, True), (1.5, False)):
            away = math.radians(angle / 2 + inside)
            ray = [math.cos(away), 0.0, 0.0]
            ray[1 + axis] = math.sin(away)
            pitched = [
                0.05071 + math.cos(0.6929) * ray[0] + math.sin(0.6929) * ray[2],
                ray[1],
                0.01774 - math.sin(0.6929) * ray[0] + math.cos(0.6929) * ray[2],
            ]
            ball = client.createVisualShape(client.GEOM_SPHERE, radius=0.015)
            body = client.createMultiBody(0.0, -1, ball, basePosition=pitched)
            if seen:
                where = np.argwhere(camera.rgb(client, level).min(-1) < 255).mean(0)
                assert where == pytest.approx([60, 4] if axis == 0 else [4, 80], abs=2)
            else:
                with pytest.raises(WorldError, match="sees nothing"):
                    camera.rgb(client, level)
            client.removeBody(body)


def test_studio_shows_what_the_robot_sees(studio, scene):
    fine = Studio(Camera(64, 48))
    for kind in MUGS:
        for pose, light in zip(POSES, LIGHTS, strict=True):
            scene.place(kind, pose)
            for view in (studio, fine):
                seen = view.camera.rgb(scene.client, scene.robot.head_pose(), light)
                assert np.array_equal(view.rgb(kind, pose, light), seen)


def test_head_at_rest_is_the_robots(scene):
    position, orientation = scene.robot.head_pose()
    assert HEAD_AT_REST[0] == pytest.approx(position, abs=1e-6)
    assert HEAD_AT_REST[1] == pytest.approx(orientation, abs=1e-6)


@pytest.mark.parametrize("pose", POSES)
def test_the_camera_sees_table_and_mug_only(scene, pose, monkeypatch):
    """The arms at rest are out of view, and the table fills it."""
    mug = scene.place(MUGS[3], pose)
    render, pictures = scene.client.getCameraImage, []

    def spy(*arguments, **options):
        pictures.append(render(*arguments, **options))
        return pictures[-1]

    monkeypatch.setattr(scene.client, "getCameraImage", spy)
    Camera(64, 48).rgb(scene.client, scene.robot.head_pose())
    table = scene.client.rayTest([0.3, 0.2, 1.0], [0.3, 0.2, 0.0])[0][0]
    assert np.unique(pictures[0][4]).tolist() == [table, mug.body]


@pytest.mark.parametrize("x", [0.16, 0.17, 0.20])
def test_the_mug_lies_within_the_picture(x):
    red, green, _ = Studio(Camera(64, 48)).rgb(MUGS[3], Pose(x)).transpose(2, 0, 1)
    rows, columns = np.nonzero(red > 2.0 * green)
    assert 500 < len(rows) < 1000
    assert 0 < rows.min() and rows.max() < 48 - 1
    assert 1 < columns.min() and columns.max() < 64 - 1


def test_frames_repeat_in_a_fresh_studio_whatever_was_seen_before(studio):
    expected = studio.rgb(MUGS[2], POSES[1], LIGHTS[1]).tobytes()
    for kind, pose, light in zip(MUGS, [*POSES, Pose()], [*LIGHTS, Light()], strict=True):
        studio.rgb(kind, pose, light)
    assert studio.rgb(MUGS[2], POSES[1], LIGHTS[1]).tobytes() == expected
    assert Studio().rgb(MUGS[2], POSES[1], LIGHTS[1]).tobytes() == expected


def test_light_does_not_stick():
    """Bullet keeps the last light for what a call leaves out; frames must not depend on it."""
    client = connect()
    furnish(client)
    camera, head = Camera(), ((0.3, 0.0, 0.4596), (0.0, 0.0, 0.0, 1.0))  # sees the table's end
    expected = camera.rgb(client, head)
    client.getCameraImage(
        16,
        12,
        lightDirection=[-1, -1, 0.1],
        lightColor=[0.0, 1.0, 0.0],
        lightDistance=9.0,
        shadow=1,
        lightAmbientCoeff=0.1,
        lightDiffuseCoeff=0.1,
        lightSpecularCoeff=0.9,
        renderer=client.ER_TINY_RENDERER,
    )
    assert np.array_equal(camera.rgb(client, head), expected)


def test_strength_scales_all_light(studio):
    usual = studio.rgb(MUGS[3], Pose(), Light()).astype(float)
    half = studio.rgb(MUGS[3], Pose(), Light(strength=0.5)).astype(float)
    assert half == pytest.approx(usual / 2, abs=1)


def test_direction_moves_the_shade(studio):
    left = studio.grey(MUGS[0], Pose(), Light(direction=(-0.2, 0.8, 1.0)))[0]
    right = studio.grey(MUGS[0], Pose(), Light(direction=(-0.2, -0.8, 1.0)))[0]
    assert left[7, 6] > left[7, 9] + 0.02  # the cup, brighter towards the lamp
    assert right[7, 6] < right[7, 9] - 0.02


def test_the_mugs_look_different(studio):
    frames = [studio.grey(kind, Pose()) for kind in MUGS]
    for i, one in enumerate(frames):
        for other in frames[:i]:
            assert (np.abs(one - other) > 0.2).sum() >= 8
    bare, left, right, both = (frame[0] for frame in frames)
    assert np.array_equal(left[:, 8:], bare[:, 8:])  # the left handle is on the picture's left
    assert np.array_equal(right[:, :8], bare[:, :8])
    assert np.array_equal(both, np.concatenate([left[:, :8], right[:, 8:]], axis=1))


def test_a_linear_classifier_tells_the_mugs_apart(studio):
    """400 frames to fit, 200 to test; ±1 cm, ±10° and light within ±40 % in slope and ±20 %."""
    random = np.random.default_rng(0)
    usual = Light()

    def draw(count):
        frames, kinds = [], np.arange(count) % 4
        for kind in kinds:
            x, y, turn, along, across, strength = random.uniform(-1, 1, 6)
            pose = Pose(0.17 + 0.01 * x, 0.01 * y, math.radians(10 * turn))
            shifted = (usual.direction[0] + 0.4 * along, usual.direction[1] + 0.4 * across, 1.0)
            light = replace(usual, direction=shifted, strength=1 + 0.2 * strength)
            frames.append(studio.grey(MUGS[kind], pose, light).ravel())
        return torch.tensor(np.array(frames)), torch.tensor(kinds)

    frames, kinds = draw(400)
    mean = frames.mean(0)
    weight = torch.zeros(frames.shape[1], 4, requires_grad=True)
    optimiser = torch.optim.LBFGS([weight], max_iter=200, line_search_fn="strong_wolfe")

    def loss():
        optimiser.zero_grad()
        value = torch.nn.functional.cross_entropy((frames - mean) @ weight, kinds)
        value = value + 1e-5 * weight.square().sum()
        value.backward()
        return value

    optimiser.step(loss)
    held_back, truth = draw(200)
    assert (((held_back - mean) @ weight).argmax(-1) == truth).double().mean() >= 0.98


@pytest.mark.parametrize("field", ["width", "height", "supersampling"])
@pytest.mark.parametrize("value", [0, -1, 1.5, True])
def test_bad_sizes_are_refused(field, value):
    with pytest.raises(ValueError, match=f"{field} must be a positive integer, got {value}"):
        Camera(**{field: value})


def test_blank_frames_are_refused():
    with pytest.raises(WorldError, match="the camera sees nothing") as error:
        Camera().grey(connect(), HEAD_AT_REST)
    assert "\n" not in str(error.value)
