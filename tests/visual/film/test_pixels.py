"""`env.render()` in Gymnasium, and TorchRL's transforms."""

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs import GymEnv
from torchrl.record import PixelRenderTransform, VideoRecorder
from torchrl.record.loggers import CSVLogger

from buggy_rl.core import keys
from buggy_rl.task.env import make_env, make_simulator
from buggy_rl.task.gym import NAME, WaypointsEnv
from buggy_rl.visual.film.director import Director
from buggy_rl.visual.film.film import Pixels, renderable
from buggy_rl.visual.film.options import PictureConfig
from buggy_rl.visual.film.renderer import open_renderer
from buggy_rl.visual.film.track import from_rollout

SMALL = PictureConfig(renderer="drawing", size=[96, 64], inset=False)
SHAPE = (64, 96, 3)
FORWARD = np.array([0.0, 0.3], np.float32)


def make_gym(**options):
    return gymnasium.make(NAME, engine="kinematic", picture=SMALL, **options).unwrapped


def test_a_gymnasium_environment_renders_what_it_drives():
    env = make_gym(render_mode="rgb_array")
    env.reset(seed=1)
    first = env.render()
    for _ in range(20):
        env.step(FORWARD)
    assert first.shape == SHAPE
    assert first.dtype == np.uint8
    assert (env.render() != first).any()
    env.reset(seed=1)
    np.testing.assert_array_equal(env.render(), first)  # nothing is left of the drive before


def test_without_a_render_mode_nothing_is_drawn():
    env = make_gym()
    env.reset(seed=1)
    assert env.render() is None
    with pytest.raises(ValueError, match="render_mode='human': must be rgb_array or None"):
        WaypointsEnv("kinematic", render_mode="human")


def test_rendering_before_a_reset_is_refused():
    with pytest.raises(RuntimeError, match="call reset first"):
        make_gym(render_mode="rgb_array").render()


def test_torchrl_takes_the_gymnasium_environment_with_pixels():
    env = GymEnv(
        NAME, engine="kinematic", picture=SMALL, from_pixels=True,
        pixels_only=False,
    )  # fmt: skip
    assert env.rollout(2)["pixels"].shape == (2, *SHAPE)


@pytest.mark.parametrize("batch", [(), (2,)])
def test_torchrls_transforms_take_frames_and_record_them(batch, tmp_path):
    env = renderable(make_env("kinematic", batch_size=batch), SMALL)
    env = env.append_transform(PixelRenderTransform(pass_tensordict=True))
    recorder = VideoRecorder(CSVLogger("run", str(tmp_path), video_format="pt"), "film", skip=1)
    env = env.append_transform(recorder)
    rollout = env.rollout(3)
    assert rollout["next", "pixels"].shape == (*batch, 3, *SHAPE)
    assert rollout["next", "pixels"].dtype == torch.uint8
    recorder.dump()
    assert list(tmp_path.rglob("film_*.pt"))


def test_a_simulator_without_a_task_is_drawn_too():
    pixels = Pixels(env := make_simulator("kinematic", 1), SMALL)
    assert pixels(env.reset()).shape == (1, *SHAPE)


def test_a_live_frame_is_that_of_the_film():
    env = make_simulator("kinematic", 1)
    action = torch.tensor([[0.4, 0.0]])

    def straight(state: TensorDictBase) -> TensorDictBase:  # by its types TorchRL knows it
        return state.set(keys.ACTION, action)

    rollout = env.rollout(30, straight)
    pixels = Pixels(env, SMALL)
    for row in range(30):
        pixels.record(rollout[:, row])
    track = from_rollout(rollout[0], "car", env.dt)
    # Straight ahead, so that the command, which a bare simulator does not tell, turns no wheel.
    shot = Director([track], aspect=96 / 64).shot(track.duration)
    with open_renderer("drawing", (96, 64), False) as renderer:
        (expected,) = renderer.frames([shot])
    np.testing.assert_array_equal(pixels.frame()[0], expected)


def test_too_many_cars_are_refused():
    with pytest.raises(ValueError, match="17 environments are too many to draw: the most are 16"):
        Pixels(make_simulator("kinematic", 17), SMALL)
