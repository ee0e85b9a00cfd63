"""What every engine must prove, whatever moves the car in it."""

import copy
import pickle
from contextlib import nullcontext
from functools import partial
from importlib.util import find_spec
from itertools import pairwise, product

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import ParallelEnv, SerialEnv, StepCounter, TransformedEnv
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.core.vehicle import rotate
from buggy_rl.simulators import ENGINES, make_engine
from buggy_rl.simulators.learned.factory import ModelConfig, make_model
from tests.simulators.steps import follow, start, step

FLIP = (1.0, -1.0, -1.0)  # left for right, of a pose or a velocity

# Parameters that tell left from right, at values at which they do not.
SYMMETRIC = {"sensor_y": 0.0, "steering_offset": 0.0, "steering_trim": 0.0}
PAIRS = (
    ("left_angle", "right_angle"),
    ("left_steepness", "right_steepness"),
    ("steering_left", "steering_right"),
    ("lock_left", "lock_right"),
)
# Where a parameter is felt only beside another value of a second one: the knee of an empty battery.
TELLING = {"initial_charge": 0.1}


def untrained_model():
    """A small history MLP as training would begin with, of the range of an indoor car."""
    # On the CPU whatever the default device is, so that every process draws the same weights.
    with torch.device("cpu"), torch.random.fork_rng():
        torch.manual_seed(0)
        model = make_model(ModelConfig("mlp", options={"rows": 3}))
    model.output_scale.fill_(0.02)
    model.envelope.low.copy_(torch.tensor([-1.0, -3.5, -6.5, -1.0, -1.0]))
    model.envelope.high.copy_(torch.tensor([3.5, 3.5, 6.5, 1.0, 1.0]))
    return model


WARP = pytest.param(
    "mujoco on warp",
    marks=[
        pytest.mark.skipif(not find_spec("mujoco_warp"), reason="mujoco-warp is not installed"),
        pytest.mark.slow,  # 100 s on Warp's CPU device
    ],
)


ON_GPU = [
    pytest.param(
        f"{name} on cuda",
        marks=[
            pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here"),
            *(WARP.marks[:1] if "warp" in name else ()),
        ],
    )
    for name in (*sorted(ENGINES), "mujoco on warp")
]


def plain(name):
    """The engine of a name such as `mujoco on warp on cuda`."""
    return name.partition(" on ")[0]


def make(name, batch_size=(), **options):
    name, *where = name.split(" on ")
    for backend in ("warp", "closed"):
        if backend in where:
            options["backend"] = backend
    if "cuda" in where:
        options["device"] = "cuda"
    if name in ("learned", "surrogate"):
        options["model"] = untrained_model()
    if name == "surrogate":
        options["simulator"] = "mujoco"
    return make_engine(name, batch_size, **options)


def same(engine, first, second):
    """Whether tensors are equal to the last bit; of MuJoCo Warp on a GPU, to rounding.

    There contacts are collected in the order in which threads find them.
    """
    if getattr(engine, "backend", "cpu") == "warp" and engine.device.type == "cuda":
        return torch.allclose(first, second, atol=1e-4, rtol=1e-5)
    return torch.equal(first, second)


def symmetric(engine):
    """The engine with left and right alike, and as many cars."""
    values = {n: v for n, v in SYMMETRIC.items() if n in engine.declared}
    for left, right in PAIRS:
        if left in engine.declared:
            values[right] = float(engine.values[left])
    tensors = {name: torch.full(engine.batch_size, value) for name, value in values.items()}
    return engine.with_parameters(TensorDict(tensors, batch_size=engine.batch_size))


def manoeuvre(steps=60):
    """Actions [steps, 2] with throttle and both directions, starting from a turn to the left."""
    time = torch.arange(steps) * 0.01
    throttle = 0.1 + 0.5 * torch.sin(3 * time)
    return torch.stack([throttle, 0.7 * torch.cos(7 * time)], -1)


@pytest.fixture(autouse=True)
def where(request):
    """What the tests make is on the device of their engine."""
    gpu = "cuda" in request.node.callspec.id if hasattr(request.node, "callspec") else False
    with torch.device("cuda") if gpu else nullcontext():
        yield


NAMES = [*sorted(ENGINES), "mujoco on closed", WARP, *ON_GPU]


@pytest.fixture(params=NAMES)
def name(request):
    return request.param


@pytest.fixture(params=[(), (4,)], ids=["one", "four"])
def engine(name, request):
    return make(name, request.param)


def test_it_keeps_its_specs(engine):
    check_env_specs(engine)
    assert engine.batch_locked
    assert engine.dt == 0.01


def test_half_its_step_and_half_of_that_come_closer_to_one_another(name):
    engine, ends = make(name), []
    for _ in range(3):
        state = start(engine, velocity=(1.5, 0.0, 0.0))
        ends.append(follow(engine, state, manoeuvre(40))[0][-1])
        if not engine.half_step:
            pytest.skip("does not solve equations in steps")
        engine = make(name, **engine.half_step)
    first, second = (float((a - b).norm()) for a, b in pairwise(ends))
    assert 0 < second < 0.7 * first  # of first order it is a half of it


def test_pose_and_velocity_are_single_precision_on_the_engines_device(engine):
    for state in (engine.reset(), engine.rand_step(engine.reset())["next"]):
        assert state.device == engine.device
        for key in (keys.POSE, keys.VELOCITY):
            assert state[key].dtype == torch.float32
            assert state[key].shape == (*engine.batch_size, 3)


def in_batches():
    """Every engine in serial environments of one and of four cars, some in processes as well.

    Processes take a second each and know nothing of engines; the rest of the pairs are slow.
    """
    fast = {("mujoco", ())}
    for each in NAMES:
        name, marks = (each, ()) if isinstance(each, str) else (each.values[0], each.marks)
        for kind, size in product((SerialEnv, ParallelEnv), ((), (4,))):
            slow = kind is ParallelEnv and (name, size) not in fast and "cuda" not in name
            more = [pytest.mark.slow] if slow else []
            label = f"{name}-{kind.__name__}-{'four' if size else 'one'}"
            yield pytest.param(name, kind, size, marks=[*marks, *more], id=label)


@pytest.mark.parametrize(("name", "kind", "batch_size"), in_batches())
def test_it_drives_alike_inside_a_batch_of_environments(name, kind, batch_size):
    start_method = "spawn" if "cuda" in name else "fork"  # a forked process cannot use the GPU
    options = {"mp_start_method": start_method} if kind is ParallelEnv else {}
    actions = manoeuvre(5)
    lone = make(name, batch_size)
    expected, _, _ = follow(lone, lone.reset(), actions)
    several = kind(2, partial(make, name, batch_size), **options)
    try:
        check_env_specs(several)
        poses, _, _ = follow(several, several.reset(), actions)
    finally:
        several.close()
    assert same(lone, poses[:, 0], expected)
    assert same(lone, poses[:, 1], expected)


def test_the_same_seed_gives_the_same_trajectory(name):
    def drive():
        engine = make(name, (4,))
        engine.set_seed(3)
        torch.manual_seed(3)
        return engine, engine.rollout(10)

    (engine, first), (_, second) = drive(), drive()
    for key in (keys.ACTION, ("next", keys.POSE), ("next", keys.VELOCITY)):
        assert same(engine, first[key], second[key])


def test_two_steps_from_one_tensordict_are_equal_and_leave_it_as_it_was(engine):
    state = start(engine, velocity=(1.5, 0.1, 0.5))
    for action in manoeuvre(3):
        state = step(engine, state, action)
    state = state.set(keys.ACTION, torch.tensor([0.4, -0.3]).expand(*engine.batch_size, 2).clone())
    before = state.clone()
    first = engine.step(state.copy())["next"].clone()
    assert (state == before).all()
    engine.rollout(3)  # whatever happens in between
    second = engine.step(state.copy())["next"]
    assert all(same(engine, first[key], value) for key, value in second.items())


def pickled(engine):
    return pickle.loads(pickle.dumps(engine))


@pytest.mark.parametrize("copied", [copy.deepcopy, pickled])
def test_a_copy_goes_on_from_a_state_to_the_same_bits(name, copied):
    declared = list(make(name).declared.values())[:2]
    values = TensorDict({p.name: torch.linspace(p.value, p.upper, 4) for p in declared}, [4])
    engine = make(name).with_parameters(values)
    _, _, state = follow(engine, start(engine, velocity=(1.5, 0.1, 0.5)), manoeuvre(10))
    other = copied(engine)
    poses, velocities, _ = follow(engine, state, manoeuvre(10))
    other_poses, other_velocities, last = follow(other, state, manoeuvre(10))
    assert same(engine, other_poses, poses)
    assert same(engine, other_velocities, velocities)
    follow(other, other.reset(), manoeuvre(3))  # what a copy does is not felt by the first
    again = follow(engine, state, manoeuvre(10))[2]
    assert all(same(engine, again[key], last[key]) for key in engine.state_spec)
    for key, value in engine.values.items():
        assert torch.equal(other.values[key], value), key


def test_cars_of_a_batch_do_not_feel_one_another(name):
    engine, lone = make(name, (4,)), make(name)
    velocity = torch.tensor([[0.0, 0, 0], [1.0, 0, 0.5], [2.0, 0.2, -1.0], [0.5, -0.1, 2.0]])
    share = torch.tensor([1.0, -1.0, 0.5, 0.0])
    actions = manoeuvre(30)[:, None] * share[:, None]  # (30, 4, 2)
    poses, velocities, _ = follow(engine, start(engine, velocity=velocity), actions)
    for i in range(4):
        pose, own, _ = follow(lone, start(lone, velocity=velocity[i]), actions[:, i])
        # Vectorised arithmetic may round the last bit differently in another place of a batch.
        torch.testing.assert_close(poses[:, i], pose, atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(velocities[:, i], own, atol=1e-4, rtol=1e-4)


def test_a_reset_at_a_pose_and_a_velocity_starts_there(engine):
    pose, velocity = (3.0, -2.0, 0.7), (1.2, 0.05, 0.4)
    state = start(engine, velocity, pose)
    assert torch.equal(state[keys.POSE], torch.tensor(pose).expand(*engine.batch_size, 3))
    assert torch.equal(state[keys.VELOCITY], torch.tensor(velocity).expand(*engine.batch_size, 3))
    moved = step(engine, state, (-0.5, 0.0))
    # 1.2 m/s along 0.7 rad for 10 ms: 9 mm and 8 mm
    shift = moved[keys.POSE] - state[keys.POSE]
    torch.testing.assert_close(
        shift[..., :2], torch.tensor([0.0092, 0.0077]).expand_as(shift[..., :2]), atol=3e-3, rtol=0
    )


def test_a_reset_without_either_starts_at_rest_in_the_origin(engine):
    state = engine.reset()
    assert not state[keys.POSE].any()
    assert not state[keys.VELOCITY].any()


def moved(pose, turn, shift):
    """A pose [*, 3] after the world was turned by `turn` rad and then shifted by [2] m."""
    xy = rotate(pose[..., :2], torch.full(pose.shape[:-1], turn)) + shift
    return torch.cat([xy, pose[..., 2:] + turn], -1)


def test_the_place_and_the_heading_do_not_matter(name):
    engine = make(name)
    turn, shift = 2.1, torch.tensor([4.0, -3.0])
    velocity = (1.0, 0.1, 0.8)
    poses, velocities, _ = follow(engine, start(engine, velocity=velocity), manoeuvre())
    elsewhere = start(engine, pose=(4.0, -3.0, 2.1), velocity=velocity)
    other_poses, other_velocities, _ = follow(engine, elsewhere, manoeuvre())
    torch.testing.assert_close(other_poses, moved(poses, turn, shift), atol=1e-3, rtol=0)
    torch.testing.assert_close(other_velocities, velocities, atol=2e-3, rtol=0)


def test_an_edited_pose_is_honoured(name):
    engine = make(name)
    turn, shift = -0.9, torch.tensor([1.0, 2.0])
    state = start(engine, velocity=(1.0, 0.0, 0.5))
    for action in manoeuvre(20):
        state = step(engine, state, action)
    edited = state.clone().set(keys.POSE, moved(state[keys.POSE], turn, shift))
    poses, velocities, _ = follow(engine, state, manoeuvre(20))
    other_poses, other_velocities, _ = follow(engine, edited, manoeuvre(20))
    torch.testing.assert_close(other_poses, moved(poses, turn, shift), atol=1e-3, rtol=0)
    torch.testing.assert_close(other_velocities, velocities, atol=2e-3, rtol=0)


def test_an_edited_velocity_is_honoured(name):
    engine = make(name)
    state = start(engine, velocity=(1.0, 0.0, 0.0))
    for action in manoeuvre(20):
        state = step(engine, state, action)
    edited = state.clone().set(keys.VELOCITY, torch.tensor([2.5, 0.0, 0.0]))
    before, after = step(engine, state, (0.0, 0.0)), step(engine, edited, (0.0, 0.0))
    assert float(before[keys.VELOCITY][0]) < 2.0
    assert float(after[keys.VELOCITY][0]) == pytest.approx(2.5, abs=0.3)
    # and the pose follows the edit: 2.5 m/s for 10 ms
    way = (after[keys.POSE] - edited[keys.POSE])[:2].norm()
    assert float(way) == pytest.approx(0.025, abs=0.004)


# Nothing promises symmetry of a network; mirrored training data only encourages it.
OTHERS = [p for p in ON_GPU if p.values[0] != "learned on cuda"]


@pytest.mark.parametrize("name", [*sorted(set(ENGINES) - {"learned"}), WARP, *OTHERS])
def test_left_is_the_mirror_of_right(name):
    engine = symmetric(make(name))
    velocity, flip = torch.tensor([1.0, 0.1, 0.8]), torch.tensor(FLIP)
    actions = manoeuvre()
    poses, velocities, _ = follow(engine, start(engine, velocity=velocity), actions)
    mirrored = start(engine, velocity=velocity * flip)
    other_poses, other_velocities, _ = follow(engine, mirrored, actions * flip[:2])
    torch.testing.assert_close(other_poses, poses * flip, atol=1e-3, rtol=0)
    torch.testing.assert_close(other_velocities, velocities * flip, atol=2e-3, rtol=0)
    assert poses[:, 1].abs().max() > 0.02 or plain(name) == "hold"  # m: it did turn


def test_at_rest_without_throttle_it_stays_at_rest(name):
    engine = make(name, (3,))
    steered = torch.tensor([[-1.0, -1.0], [-1.0, 0.0], [-1.0, 1.0]])
    poses, velocities, _ = follow(engine, engine.reset(), steered.expand(60, 3, 2))
    assert poses.abs().max() < 3e-4  # m, rad
    assert velocities.abs().max() < 1e-3  # m/s, rad/s


@pytest.mark.parametrize("steps", [150, pytest.param(500, marks=pytest.mark.slow)])
def test_full_throttle_and_full_lock_from_rest_run_away_nowhere(name, steps):
    engine = make(name, (2,))
    steered = torch.tensor([[1.0, -1.0], [1.0, 1.0]])
    poses, velocities, _ = follow(engine, engine.reset(), steered.expand(steps, 2, 2))
    assert poses.isfinite().all()
    assert poses[..., :2].abs().max() < 50  # m: 5 s at the top speed of 10 m/s
    assert velocities[..., :2].norm(dim=-1).max() < 12  # m/s
    assert velocities[..., 2].abs().max() < 40  # rad/s


def test_actions_out_of_range_are_taken_as_the_nearest_bound(engine):
    state = start(engine, velocity=(1.0, 0.0, 0.0))
    beyond, bound = state, state
    for _ in range(10):
        beyond, bound = step(engine, beyond, (7.0, -3.0)), step(engine, bound, (1.0, -1.0))
    assert same(engine, beyond[keys.POSE], bound[keys.POSE])
    assert same(engine, beyond[keys.VELOCITY], bound[keys.VELOCITY])


def test_a_reset_of_some_cars_leaves_the_others_as_they_are(name):
    engine = make(name, (4,))
    state = start(engine, velocity=(1.0, 0.0, 0.5))
    for action in manoeuvre(5):
        state = step(engine, state, action)
    mask = torch.tensor([True, False, False, True])
    asked = state.clone().set("_reset", mask[:, None])
    asked[keys.POSE], asked[keys.VELOCITY] = torch.full((4, 3), 9.0), torch.zeros(4, 3)
    expected = start(engine, pose=(9.0, 9.0, 9.0))
    asked[keys.POSE][~mask] = state[keys.POSE][~mask]
    asked[keys.VELOCITY][~mask] = state[keys.VELOCITY][~mask]
    after = engine.reset(asked.exclude(*engine._latent_specs()), set_state=True)
    for key in engine.state_spec:
        assert torch.equal(after[key][mask], expected[key][mask]), key
        if key in (keys.POSE, keys.VELOCITY):
            assert torch.equal(after[key][~mask], state[key][~mask]), key


def test_cars_that_are_done_start_again_and_the_others_drive_on(name):
    engine = make(name, (4,))
    counted = TransformedEnv(engine, StepCounter(max_steps=4))
    state = counted.reset()
    state["step_count"] = torch.tensor([[0], [2], [0], [3]])  # car 3 ends first, then car 1
    reference = engine.reset()
    for k, action in enumerate(manoeuvre(3)):
        reference = step(engine, reference, action)
        state[keys.ACTION] = action.expand(4, 2).clone()
        data, state = counted.step_and_maybe_reset(state)
        done = torch.tensor([False, k == 1, False, k == 0])
        assert torch.equal(data["next", "done"][:, 0], done)
        # what is recorded is the true last state, what goes on is the fresh one
        kept = torch.tensor([True, k < 2, True, False])
        true_end = torch.tensor([True, k < 2, True, k < 1])
        for key in engine.state_spec:
            assert same(engine, data["next", key][true_end], reference[key][true_end]), key
            going_on = kept & ~done
            assert same(engine, state[key][going_on], reference[key][going_on]), key
            assert torch.equal(state[key][done], engine.reset()[key][done]), key


def test_parameters_are_declared_in_full(name):
    for key, parameter in make(name).declared.items():
        assert parameter.name == key
        assert parameter.lower < parameter.upper, key
        assert parameter.lower <= parameter.value <= parameter.upper, key
        assert parameter.unit, key
        assert len(parameter.meaning) > 10, key


@pytest.mark.parametrize("name", ["kinematic", "mujoco", "reference", "single_track"])
def test_what_has_equations_declares_parameters_and_the_step_that_solves_them(name):
    engine = make(name)
    assert engine.declared
    assert engine.half_step


def test_every_parameter_changes_the_drive(name):
    declared = list(make(name).declared.values())
    count = len(declared)
    if not count:
        pytest.skip("declares no parameter")
    values = TensorDict(batch_size=[count + 1])
    for i, parameter in enumerate(declared):
        value = TELLING.get(parameter.name, parameter.value)
        shift = 0.2 * (parameter.upper - parameter.lower)
        values[parameter.name] = torch.full((count + 1,), value)
        values[parameter.name][i] += shift if value + shift <= parameter.upper else -shift
    engine = make(name).with_parameters(values)
    assert engine.batch_size == (count + 1,)
    # full throttle, half throttle and coasting, straight, weaving and from lock to lock
    throttle = torch.tensor([1.0, 1.0, 0.0, 0.0, -1.0, -1.0]).repeat_interleave(25)
    time = torch.arange(150) * 0.01
    steering = torch.where(time < 1.0, time * torch.sin(8 * time), torch.sin(12 * time).sign())
    _, velocities, _ = follow(engine, engine.reset(), torch.stack([throttle, steering], -1))
    change = (velocities - velocities[:, -1:]).abs().amax((0, 2))  # (count + 1,)
    idle = [p.name for p, c in zip(declared, change[:-1], strict=True) if c < 1e-4]
    assert idle == []


def test_the_declared_values_are_those_in_use(name):
    engine = make(name)
    declared = {n: torch.tensor(p.value) for n, p in engine.declared.items()}
    again = engine.with_parameters(TensorDict(declared))
    poses, _, _ = follow(engine, engine.reset(), manoeuvre(20))
    other_poses, _, _ = follow(again, again.reset(), manoeuvre(20))
    assert same(engine, poses, other_poses)


def test_an_unknown_parameter_is_refused_with_those_there_are(name):
    engine = make(name)
    available = ", ".join(sorted(engine.declared)) or "none"
    with pytest.raises(KeyError, match="no parameter colour; available") as refused:
        make(name, parameters={"colour": 1.0})
    assert available in str(refused.value)
    with pytest.raises(KeyError, match="no parameter colour; available"):
        engine.with_parameters(TensorDict({"colour": torch.tensor(1.0)}))
