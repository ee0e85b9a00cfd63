import numpy as np
import pytest
import torch
from torchrl.envs import TransformedEnv

from buggy_rl.engines import make_engine
from buggy_rl.task.gym import WaypointsEnv
from buggy_rl.viz.film import still
from buggy_rl.viz.film.still import Still, with_pixels

SMALL = (96, 64)


@pytest.fixture(autouse=True)
def drawn(monkeypatch):
    """Whatever OpenGL there is, these are drawn, small."""
    from buggy_rl.viz.film.drawn import Drawn

    monkeypatch.setattr(still, "studio", lambda _, size, cars, tell: Drawn([1.0] * cars, size))


def test_gymnasium_gets_pictures_of_the_car_on_its_path():
    env = WaypointsEnv("kinematic", render_mode="rgb_array")
    with pytest.raises(RuntimeError, match="render before reset"):
        env.render()
    env.reset(seed=0)
    before = env.render()
    for _ in range(30):
        env.step(np.array([0.3, 0.4], np.float32))
    after = env.render()
    assert before is not None
    assert before.shape == (480, 640, 3)
    assert before.dtype == np.uint8
    assert (before != after).any()
    env.close()


def test_without_a_render_mode_there_is_no_picture():
    env = WaypointsEnv("kinematic")
    env.reset(seed=0)
    assert env.render() is None


@pytest.mark.parametrize("batch", [(), (2,)])
def test_torchrl_records_pixels_of_any_engine(batch):
    env = with_pixels(TransformedEnv(make_engine("kinematic", batch)), size=SMALL)
    pixels = env.rollout(4)["next", "pixels"]
    assert pixels.dtype == torch.uint8
    assert pixels.shape == (*batch, 4, 64, 96, 3)


def test_a_car_that_is_set_down_elsewhere_has_no_trail_to_there():
    draw = Still(size=SMALL)
    engine = make_engine("kinematic", 1)
    state = engine.reset()
    draw(state)
    state["pose"] = state["pose"] + 3.0
    draw(state)
    assert len(draw._trail) == 1
