"""Simulators from functions, Gymnasium environments and MJCF: values, and refusals."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core.parameters import Parameter
from buggy_rl.simulators import from_gymnasium, from_mjcf, from_step, make_engine, simulator_name
from buggy_rl.task.env import make_simulator

GAIN = Parameter("gain", 2.0, 0.5, 8.0, "m/s^2", "Acceleration at throttle 1.")


def point(state, action, numbers=None):
    """Speed grows by 0.01 gain throttle, x by 0.01 vx, `count` by 1, whatever the shape."""
    gain = GAIN.value if numbers is None else numbers["gain"]
    velocity, pose = np.array(state["velocity"]), np.array(state["pose"])
    velocity[..., 0] += 0.01 * gain * action[..., 0]
    pose[..., 0] += 0.01 * velocity[..., 0]
    return {"pose": pose, "velocity": velocity, "count": state["count"] + 1}


def one(pose, velocity):
    return {"count": 0}


def many(pose, velocity):
    return {"count": np.zeros(len(pose), int)}


def stepped(factory, count=2):
    engine = make_engine(factory, count)
    start = TensorDict({keys.VELOCITY: torch.tensor([[1.0, 0.0, 0.0]] * count)}, [count])
    state = engine.reset(start, set_state=True)
    state[keys.ACTION] = torch.tensor([[0.5, 0.0], [-0.5, 0.0]])[:count]
    return engine.step(state)["next"]


@pytest.mark.parametrize("batched", [False, True])
def test_a_step_is_that_of_the_function(batched):
    after = stepped(from_step(many if batched else one, point, batched=batched))
    # 1 + 0.01 * 2 * (+-0.5); x = 0.01 vx
    torch.testing.assert_close(after[keys.VELOCITY][:, 0], torch.tensor([1.01, 0.99]))
    torch.testing.assert_close(after[keys.POSE][:, 0], torch.tensor([0.0101, 0.0099]))
    assert after["count"].tolist() == [1, 1]
    assert after["count"].dtype == torch.int64


@pytest.mark.parametrize("batched", [False, True])
def test_a_declared_parameter_is_each_environments_own(batched):
    factory = from_step(many if batched else one, point, parameters=[GAIN], batched=batched)
    engine = make_engine(factory, 2, parameters={"gain": 4.0})
    assert engine.declared["gain"].lower == 0.5
    engine = engine.with_parameters(TensorDict({"gain": torch.tensor([1.0, 8.0])}, [2]))
    state = engine.reset().set(keys.ACTION, torch.ones(2, 2))
    after = engine.step(state)["next"]
    torch.testing.assert_close(after[keys.VELOCITY][:, 0], torch.tensor([0.01, 0.08]))


def test_without_a_reset_pose_and_velocity_are_the_state():
    def glide(state, action):
        return {"pose": state["pose"] + 0.01 * state["velocity"], "velocity": state["velocity"]}

    assert stepped(from_step(None, glide))[keys.POSE][0].tolist() == pytest.approx([0.01, 0, 0])


def test_a_car_of_functions_does_not_claim_the_buggys_dimensions():
    assert make_engine(from_step(one, point), 1).vehicle is None


@pytest.mark.parametrize(
    ("step", "words"),
    [
        (lambda s, a: (s["pose"], s["velocity"]), "step returned a tuple: it must return a dict"),
        (lambda s, a: {"pose": s["pose"], "count": 1}, "step returned no 'velocity'"),
        (lambda s, a: {**s, "lap": 1}, "step returned 'lap', which reset does not"),
        (lambda s, a: {**s, "pose": s["pose"][:2]}, r"'pose' of shape \[2\]: must be \[3\]"),
        (lambda s, a: {**s, "count": "many"}, "count that are no numbers"),
    ],
)
def test_a_step_that_returns_something_else_is_refused(step, words):
    with pytest.raises(ValueError, match=words):
        stepped(from_step(one, step))


def test_a_simulator_is_given_as_an_object_too():
    factory = from_step(one, point)
    assert make_simulator(factory, 3).batch_size == torch.Size([3])
    assert simulator_name(factory) == "FunctionsEngine"
    assert simulator_name(stepped) == "stepped"
    with pytest.raises(ValueError, match=r"lambda> is called as factory\(batch_size, device\)"):
        make_engine(lambda: None)  # type: ignore[arg-type]


class Gym(gymnasium.Env):
    """A car on a line whose motor follows the command late; its state is a vector."""

    action_space = Box(np.float32([0, -1]), np.float32([4, 1]))
    observation_space = Box(-1, 1, (1,))
    noise = 0.0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state, self.last = np.zeros(7), 0.0
        return np.zeros(1), {}

    def step(self, action):
        x, y, yaw, vx, vy, yaw_rate, motor = self.state
        motor += 0.1 * (action[0] - motor)
        vx += 0.01 * motor + self.noise * self.np_random.normal()
        self.state = np.array([x + 0.01 * vx, y, yaw, vx, vy, yaw_rate, motor])
        self.last = action[0]
        return np.zeros(1), 0.0, False, False, {}


class Forgetful(Gym):
    """A delay of one step that its state does not show."""

    def step(self, action):
        delayed, self.last = self.last, action[0]
        result = super().step([delayed, action[1]])
        self.last = action[0]
        return result


class Noisy(Gym):
    noise = 0.01


class Switch(Gym):
    action_space = Discrete(3)


class Complete(Forgetful):
    """The same, which gives and takes all that it remembers."""

    def get_state(self):
        return {
            "pose": self.state[:3],
            "velocity": self.state[3:6],
            "rest": [self.state[6], self.last],
        }

    def set_state(self, state):
        self.state = np.array([*state["pose"], *state["velocity"], state["rest"][0]])
        self.last = float(state["rest"][1])


LAYOUT = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "motor")


def test_an_environment_by_the_layout_of_its_state_goes_on_from_there():
    after = stepped(from_gymnasium(Gym, layout=LAYOUT))
    # throttle 0.5 is 3 of the box 0..4: motor 0.3, vx 1.003
    torch.testing.assert_close(after["state"][:, 0], torch.tensor([0.3, 0.1]).double())
    torch.testing.assert_close(after[keys.VELOCITY][:, 0], torch.tensor([1.003, 1.001]))


def test_an_environment_with_methods_of_its_own_remembers_its_last_command():
    engine = make_engine(from_gymnasium(Complete), 1)
    state = engine.reset().set(keys.ACTION, torch.tensor([[1.0, 0.0]]))
    first = engine.step(state)["next"]
    assert first["rest"].tolist() == [[0.0, 4.0]]
    second = engine.step(first.set(keys.ACTION, torch.tensor([[-1.0, 0.0]])))["next"]
    torch.testing.assert_close(second["rest"], torch.tensor([[0.4, 0.0]]).double())


@pytest.mark.parametrize(
    ("make", "options", "words"),
    [
        (Gym, {}, r"its state can be neither read nor set: give its class get_state\(\)"),
        (Gym, {"layout": LAYOUT[:4]}, "layout has no vy, yaw_rate, env.unwrapped.state has 7"),
        (Gym, {"layout": LAYOUT[:6]}, "layout has 6 names, env.unwrapped.state has 7 entries"),
        (Forgetful, {"layout": LAYOUT}, "two steps from one state differ in 'pose'"),
        (Noisy, {"layout": LAYOUT}, "two steps from one state differ .* switch noise off"),
        (Switch, {"layout": LAYOUT}, r"its actions are Discrete\(3\): pass action="),
        (dict, {}, r"make\(\) returned a dict: not a gymnasium.Env"),
    ],
)
def test_an_environment_that_cannot_be_set_or_remembers_more_is_refused(make, options, words):
    with pytest.raises(ValueError, match=words) as told:
        make_engine(from_gymnasium(make, **options), 1)
    assert "\n" not in str(told.value)


def test_the_remedy_of_an_environment_with_other_actions_works():
    turned = from_gymnasium(Switch, layout=LAYOUT, action=lambda throttle, steering: [throttle, 0])
    assert float(stepped(turned)["state"][0, 0]) == pytest.approx(0.05)


CART = """<mujoco><option timestep="0.005"/><worldbody><geom type="plane" size="9 9 1"/>
<body name="cart" pos="0 0 0.1"><freejoint/><geom size="0.1" mass="1"/>
<body name="fin"><joint name="fin" axis="0 0 1"/><geom size="0.02" pos="0 0 0.2"/></body></body>
</worldbody><actuator><motor name="push" joint="fin"/>
<position name="turn" joint="fin" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"drive": "pull"}, "no actuator 'pull'; there are: 'push', 'turn'"),
        ({"body": "fin"}, "body='fin': must be a body with a free joint; there are: 'cart'"),
        ({"full_drive": None}, "'push' has no ctrlrange: add one, or pass full_drive="),
        ({"dt": 0.008}, "does not divide the control period of 0.008 s"),
        ({"xml": "nowhere.xml"}, "there is no MJCF file nowhere.xml"),
        ({"xml": "<mujoco><bodi/></mujoco>"}, "from_mjcf: XML Error"),
    ],
)
def test_what_is_wrong_with_an_mjcf_is_said_where_it_is_written(changed, words):
    given = {"xml": CART, "drive": "push", "steering": "turn", "body": "cart", "full_drive": 1.0}
    make = from_mjcf(**given)
    assert make(2, "cpu").batch_size == torch.Size([2])
    with pytest.raises(ValueError, match=words) as told:
        from_mjcf(**{**given, **changed})
    assert "\n" not in str(told.value)
