"""MuJoCo Warp beside MuJoCo, on Warp's CPU device and, where there is one, on a GPU.

The contract of all engines (tests/contracts/test_engines.py) holds for it too.
"""

import sys
from importlib.util import find_spec

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import Unbounded

from buggy_rl.core import keys
from buggy_rl.simulators import base, make_engine
from buggy_rl.simulators.mujoco import engine
from buggy_rl.simulators.mujoco.batches import SteppedCars
from buggy_rl.simulators.mujoco.engine import ACTUATORS, PHYSICS_STATE
from tests.simulators.steps import follow, start

pytestmark = pytest.mark.slow  # Warp compiles for half a minute

needs_warp = pytest.mark.skipif(
    not find_spec("mujoco_warp"), reason="mujoco-warp is not installed: pip install -e '.[gpu]'"
)
no_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
on_each_device = pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=no_gpu)])
CARS = 16
COMMANDS = [
    {},
    {"command": "throttle_brake_reverse", "drive": "all"},
    {"command": {"kind": "speed", "reverse": True}, "drive": "front"},
    {"command": "current"},
]


def drive(**options) -> Tensor:
    """Poses and velocities [T, CARS, 6] of half a second of random drives from 0 to 3 m/s."""
    generator = torch.Generator().manual_seed(1)
    velocity = torch.zeros(CARS, 3)
    velocity[:, 0] = 3.0 * torch.rand(CARS, generator=generator)
    actions = 2.0 * torch.rand(2, CARS, 2, generator=generator) - 1.0
    cars = make_engine("mujoco", CARS, **options)
    poses, velocities, _ = follow(cars, start(cars, velocity), actions.repeat_interleave(25, 0))
    return torch.cat([poses, velocities], -1).cpu()


@needs_warp
@on_each_device
@pytest.mark.parametrize(
    "options",
    COMMANDS,
    ids=lambda options: str(options.get("command")),
)
def test_it_drives_as_mujoco_does(options, device):
    expected, found = drive(**options), drive(**options, backend="warp", device=device)
    assert expected[-1, :, 5].abs().max() > 2.0  # rad/s: they did turn
    # Single precision: 1e-7 of a metre or a radian grows in half a second of sliding.
    torch.testing.assert_close(found[..., :2], expected[..., :2], atol=5e-5, rtol=0)
    torch.testing.assert_close(found[..., 2:5], expected[..., 2:5], atol=2e-4, rtol=0)
    torch.testing.assert_close(found[..., 5], expected[..., 5], atol=1e-3, rtol=0)


@needs_warp
@on_each_device
def test_contact_tyres_drive_alike_up_to_the_solver(device):
    # Both solve the same problem of friction and stop at different remainders.
    expected = drive(tyres="contact")
    found = drive(tyres="contact", backend="warp", device=device)
    apart = (found - expected)[-1, :, :2].norm(dim=-1)
    way = expected[-1, :, :2].norm(dim=-1).clamp_min(0.1)
    assert (apart / way).median() < 1e-3
    assert (apart / way).max() < 0.02


@needs_warp
@on_each_device
def test_every_car_has_parameters_of_its_own(device):
    values = {"mass": [1.4, 1.6, 2.2], "grip_rear": [0.5, 0.9, 0.7], "yaw_inertia": [0.005] * 3}
    sets = TensorDict({name: torch.tensor(each) for name, each in values.items()}, [3])
    actions = [(0.6, 0.5)] * 40
    ends = []
    for options in ({}, {"backend": "warp", "device": device}):
        cars = make_engine("mujoco", **options).with_parameters(sets)
        ends.append(follow(cars, start(cars, (2.0, 0.0, 0.0)), actions)[0][-1].cpu())
    torch.testing.assert_close(ends[1], ends[0], atol=1e-4, rtol=0)
    assert (ends[0][0] - ends[0][2]).norm() > 0.05  # the sets do differ


@needs_warp
def test_its_state_is_single_precision():
    state = make_engine("mujoco", 2, backend="warp").reset()
    assert {state[PHYSICS_STATE].dtype, state[ACTUATORS].dtype} == {torch.float32}


@needs_warp
def test_a_state_that_is_not_finite_is_refused_with_its_environment():
    cars = make_engine("mujoco", 3, backend="warp")
    state = cars.reset()
    state[keys.VELOCITY][1] = float("nan")
    state[keys.ACTION] = torch.zeros(3, 2)
    with pytest.raises(RuntimeError, match="environment 1 is not finite"):
        cars.step(state)


def test_an_unknown_backend_is_refused():
    with pytest.raises(ValueError, match="backend is 'abacus'; expected one of cpu, warp, closed"):
        make_engine("mujoco", 2, backend="abacus")


def test_without_mujoco_warp_the_error_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    monkeypatch.delitem(sys.modules, "buggy_rl.simulators.mujoco.warp_cars", raising=False)
    with pytest.raises(ImportError, match=r"pip install -e '\.\[gpu\]'"):
        make_engine("mujoco", 2, backend="warp")


class MetaCars(SteppedCars):
    """Cars whose arrays have a device but no content, and whose step is none."""

    dtype = torch.float32

    def __init__(self, car, count):
        model = car.model
        self.qpos, self.qvel = torch.zeros(count, model.nq), torch.zeros(count, model.nv)
        self.xfrc_applied, self.qfrc_applied = torch.zeros(count, model.nbody, 6), self.qvel.clone()
        for name, value in vars(self).items():
            setattr(self, name, value.to("meta"))
        self.timestep = car.timestep

    def array(self, tensor):
        return tensor.to("meta", self.dtype)

    def step(self):
        pass

    def refuse_bad(self):
        pass


@pytest.mark.parametrize("options", COMMANDS, ids=lambda options: str(options.get("command")))
@pytest.mark.parametrize("tyres", ["explicit", "contact"])
def test_forces_actuators_and_edits_stay_on_the_device(options, tyres, monkeypatch):
    # What runs on the meta device mixes no devices and reads no content: so it runs on a GPU, and
    # without a host round trip. What is read at the construction is taken out.
    with monkeypatch.context() as construction:
        construction.setattr(
            base, "Bounded", lambda _low, _high, shape, **rest: Unbounded(shape, **rest)
        )
        construction.setattr(
            engine, "make_cars", lambda _, car, count, *_rest: MetaCars(car, count)
        )
        construction.setattr(torch.Tensor, "cpu", lambda tensor: torch.zeros(tensor.shape))
        construction.setattr(torch.Tensor, "__bool__", lambda _: False)
        cars = make_engine("mujoco", 4, "meta", tyres=tyres, **options)
    state = cars._reset(None)
    result = cars._advance(state, torch.zeros(4, 2, device="meta"))
    assert {str(value.device) for value in result.values()} == {"meta"}
