"""Cars stepped in closed form beside MuJoCo's own steps.

The contract of all engines (tests/contracts/test_engines.py) holds for them too.
"""

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.mujoco.closed_cars import COMPILED, substep_kernel
from buggy_rl.simulators.mujoco.engine import ACTUATORS, PHYSICS_STATE
from buggy_rl.simulators.mujoco.forces import Forces
from tests.simulators.steps import follow, start
from tests.simulators.test_mujoco_warp import COMMANDS, drive


@pytest.mark.parametrize(
    "options",
    [*COMMANDS, {"command": "speed"}, {"dimensions": {"wheelbase": 0.5, "mass": 9.0}}],
    ids=lambda options: str(options.get("command", options)),
)
def test_they_drive_as_mujoco_does(options):
    expected, found = drive(**options), drive(**options, backend="closed")
    assert expected[-1, :, 5].abs().max() > 1.5  # rad/s: they did turn
    # Single precision: 1e-7 of a metre or a radian grows in half a second of sliding.
    torch.testing.assert_close(found[..., :2], expected[..., :2], atol=5e-5, rtol=0)
    torch.testing.assert_close(found[..., 2:5], expected[..., 2:5], atol=2e-4, rtol=0)
    torch.testing.assert_close(found[..., 5], expected[..., 5], atol=1e-3, rtol=0)


def test_every_car_has_parameters_of_its_own():
    values = {"mass": [1.4, 1.6, 2.2], "grip_rear": [0.5, 0.9, 0.7], "yaw_inertia": [0.005] * 3}
    sets = TensorDict({name: torch.tensor(each) for name, each in values.items()}, [3])
    actions, ends = [(0.6, 0.5)] * 40, []
    for options in ({}, {"backend": "closed"}):
        cars = make_engine("mujoco", **options).with_parameters(sets)
        ends.append(follow(cars, start(cars, (2.0, 0.0, 0.0)), actions)[0][-1])
    torch.testing.assert_close(ends[1], ends[0], atol=1e-4, rtol=0)
    assert (ends[0][0] - ends[0][2]).norm() > 0.05  # the sets do differ


def test_their_state_is_single_precision():
    state = make_engine("mujoco", 2, backend="closed").reset()
    assert {state[PHYSICS_STATE].dtype, state[ACTUATORS].dtype} == {torch.float32}


def test_a_state_that_is_not_finite_is_refused_with_its_environment():
    cars = make_engine("mujoco", 3, backend="closed")
    state = cars.reset()
    state[keys.VELOCITY][1] = float("nan")
    state[keys.ACTION] = torch.zeros(3, 2)
    with pytest.raises(RuntimeError, match="environment 1 is not finite"):
        cars.step(state)


def test_contacts_are_refused():
    with pytest.raises(ValueError, match="backend=closed has no contacts"):
        make_engine("mujoco", 2, tyres="contact", backend="closed")


def test_each_car_of_the_library_is_compiled():
    used = {("rear", "throttle"), ("all", "throttle"), ("all", "speed")}
    assert {substep_kernel(drive, kind) for drive, kind in used} == {*COMPILED}


@pytest.mark.parametrize("count", [1, 7, 100])
def test_no_bit_of_a_car_depends_on_how_many_are_simulated(count):
    generator = torch.Generator().manual_seed(2)
    actions = 2.0 * torch.rand(40, 101, 2, generator=generator) - 1.0
    grip, lag = (torch.rand(101, generator=generator) for _ in range(2))
    pose, velocity = 3.0 * torch.rand(2, 101, 3, generator=generator)

    def driven(cars):
        sets = TensorDict({"grip_rear": 0.5 + grip[cars], "steering_lag": 0.1 * lag[cars]})
        engine = make_engine("mujoco", backend="closed").with_parameters(sets.auto_batch_size_())
        given = TensorDict({keys.POSE: pose[cars], keys.VELOCITY: velocity[cars]})
        begin = engine.reset(given.auto_batch_size_(1), set_state=True)
        return torch.cat(follow(engine, begin, actions[:, cars])[:2], -1)

    part = slice(1, 1 + count)
    assert torch.equal(driven(slice(0, 101))[:, part], driven(part))


class OtherForces(Forces):
    """Forces that the kernel knows nothing of, such as a plant's."""


def test_forces_of_another_kind_are_refused():
    cars = make_engine("mujoco", 2, backend="closed")
    cars._forces = OtherForces(cars.car, cars._forces.values)
    state = cars.reset()
    state[keys.ACTION] = torch.zeros(2, 2)
    with pytest.raises(ValueError, match="has its own forces, not OtherForces"):
        cars.step(state)
