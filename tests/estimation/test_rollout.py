from dataclasses import replace
from itertools import pairwise

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from buggy_rl.core.longitudinal import ONE_WAY
from buggy_rl.core.stepping import trajectory
from buggy_rl.effects import offered
from buggy_rl.effects.terms.grammar import terms
from buggy_rl.estimation.bare import BareEnv, Rows
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.rollout import ParameterSets, Simulation, _commands, sensed
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.simulators import make_engine
from buggy_rl.task.augment import augmented, effects_of
from buggy_rl.task.env import make_env, make_simulator
from tests.diagnosis.planted import QUIET, planted_drives, single_track
from tests.drives import counting_drive


@pytest.fixture(scope="module")
def quiet():
    """Segments of a car without and of one with a late sensor, measured without noise."""
    cases = [{}, {"sensor_latency": {"dead_time": 0.04}}]
    return [cut_segments(d, 1.0, 1.0) for d in planted_drives(cases, 1, 5.0, quality=QUIET)]


def gains(*values):
    return ParameterSets({"steering_gain": {"gain": torch.tensor(values)}})


def test_a_simulator_predicts_its_own_recording(quiet):
    residual = Simulation(single_track).residuals(quiet[0])
    assert residual.shape == (1, 4, 10, 6)
    # Sharp commands bend the velocities by more than a parabola follows: not exactly zero.
    assert float(residual[..., :2].abs().max()) < 0.02
    wrong = Simulation(single_track).residuals(quiet[0], gains(0.7))
    assert float(wrong.square().mean()) > 100 * float(residual.square().mean())


@pytest.mark.parametrize(
    ("effect", "value"),
    [("steering_rate_limit", {"rate": 0.8}), ("steering_lag", {"time_constant": 0.5})],
)
def test_a_slow_servo_remembers_commands_from_before_the_segment(effect, value):
    # From lock to lock it takes longer than the warm-up: begun there, it would be on its way still.
    [drives] = planted_drives([{effect: value}], 1, 6.0, quality=QUIET)
    settings = ParameterSets({effect: {name: torch.tensor([v]) for name, v in value.items()}})
    residual = Simulation(single_track).residuals(cut_segments(drives, 1.0, 1.0), settings)
    assert float(residual[:, 1:, :, 5].abs().max()) < 0.15  # [rad/s]


def test_a_rollout_with_a_late_sensor_begins_from_what_it_has_told_by_the_start(quiet):
    late = ParameterSets({"sensor_latency": {"dead_time": torch.tensor([0.0, 0.035, 0.08])}})
    simulation = Simulation(single_track)
    own = simulation.readings(quiet[1], late)
    after = slice(quiet[1].start + 1, None)
    other = replace(
        quiet[1],
        smooth_pose=quiet[1].smooth_pose.clone(),
        smooth_velocity=quiet[1].smooth_velocity.clone(),
    )
    other.smooth_pose[:, after] += 1.0
    other.smooth_velocity[:, after] -= 1.0
    assert_close(simulation.readings(other, late), own)


def test_an_error_of_the_start_is_one_of_the_last_motion_that_was_told(quiet):
    late = ParameterSets({"sensor_latency": {"dead_time": torch.tensor([0.04])}})
    ahead = torch.zeros(2, 6)
    ahead[1, 0] = 0.1  # [m]
    read = Simulation(single_track).readings(quiet[1], late, ahead)
    moved = (read[1] - read[0])[..., :2].norm(dim=-1)
    assert_close(moved, torch.full_like(moved, 0.1), atol=1e-3, rtol=0)


def test_a_trial_that_runs_away_in_mujoco_is_lost_alone(quiet):
    simulation = Simulation(lambda count: make_engine("mujoco", count))
    # A yaw rate that grows by e every 5 ms is beyond MuJoCo's physics within half a second.
    damping = ParameterSets({"yaw_damping": {"rate": torch.tensor([0.0, -200.0])}})
    read = simulation.readings(quiet[0], damping)
    assert bool(read[1].isnan().any())
    assert torch.equal(read[:1], simulation.readings(quiet[0]))


def test_no_bit_of_a_rollout_depends_on_how_many_there_are(quiet, monkeypatch):
    library = Library(offered(ONE_WAY), make_engine("single_track").declared)
    one = [library.hypothesis((n,), library.trials(n, quiet[0])[0] + [0.1]) for n in library.names]
    term = [library.hypothesis((t.name,), [1.0, 0.1]) for t in terms()[::20]]
    for hypotheses in (one, term):
        settings = library.settings([(h, h.vector) for h in hypotheses])
        together = Simulation(single_track).readings(quiet[0], settings)
        with monkeypatch.context() as patched:
            patched.setattr(Simulation, "_shares", lambda _, sets, *__: _parts(sets, 23))
            patched.setattr("buggy_rl.estimation.rollout.SPARE", 0)  # 92 environments fill up to 96
            apart = Simulation(single_track).readings(quiet[0], settings)
        assert torch.equal(together, apart)


def _parts(count, size):
    return [slice(first, first + size) for first in range(0, count, size)]


def test_each_parameter_set_rolls_out_as_if_it_were_alone(quiet):
    simulation = Simulation(single_track)

    def settings(gain, mass):
        return replace(gains(*gain), parameters={"mass": torch.tensor(mass)})

    both = simulation.residuals(quiet[0], settings([0.8, 1.2], [1.5, 2.0]))
    for index, (gain, mass) in enumerate(((0.8, 1.5), (1.2, 2.0))):
        alone = simulation.residuals(quiet[0], settings([gain], [mass]))
        torch.testing.assert_close(both[index], alone[0], atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("engine", ["single_track", "reference"])
def test_without_tensordicts_a_rollout_is_the_same_to_the_last_bit(engine):
    names = offered(ONE_WAY)
    library = Library(names)
    pairs = [library.hypothesis(pair) for pair in pairwise(names)]  # of two, the order matters
    trials = [h.at(torch.full_like(h.vector, 0.5)) for h in pairs]
    settings = library.settings([(h, h.vector) for h in trials])
    sets = len(trials)
    env, stack = augmented(make_engine(engine, sets), settings.effects, {})
    motion = {"pose": torch.zeros(sets, 3), "velocity": torch.tensor([[1.5, 0.1, 0.4]] * sets)}
    state = env.reset(TensorDict(motion, [sets]), set_state=True)
    commands = torch.rand(30, sets, 2, generator=torch.Generator().manual_seed(1)) - 0.3

    def act(row, now):
        return now.set("action", commands[row])

    whole = trajectory(env, state.clone(), act, 30)
    alone = BareEnv.of(env.base_env, stack)
    assert alone is not None
    bare = trajectory(alone, Rows(state.items()), act, 30)
    for one, other in zip(whole, bare, strict=True):
        memories = [effect.memory for effect in stack if effect.memory in one.keys()]  # noqa: SIM118
        assert len(memories) > 10
        for key in ("pose", "velocity", *memories):
            assert torch.equal(one[key], other[key]), key
        assert torch.equal(sensed(one), sensed(other))


def test_an_engine_with_a_step_of_its_own_is_stepped_by_it(quiet):
    class Stuck(type(make_engine("single_track", 1))):
        def _step(self, tensordict):
            raise ValueError("stuck")

    with pytest.raises(ValueError, match="stuck"):
        Simulation(lambda count: Stuck(count)).residuals(quiet[0])


def test_a_batch_too_large_for_the_memory_is_rolled_out_in_parts(quiet, monkeypatch):
    whole = Simulation(single_track).residuals(quiet[0], gains(0.8, 1.0, 1.2))
    # One set of 4 segments each.
    monkeypatch.setattr("buggy_rl.estimation.rollout.MOST_ENVIRONMENTS", 5)
    parts = Simulation(single_track).residuals(quiet[0], gains(0.8, 1.0, 1.2))
    torch.testing.assert_close(parts, whole, atol=1e-5, rtol=1e-5)


def test_a_clock_offset_shifts_a_ramp_by_as_much():
    segments = cut_segments([counting_drive("a", 231)], 1.0, 1.0)  # throttle is the row
    given = _commands(segments, torch.tensor([0.025, -0.01]))
    # 25 ms late: what reaches the car at row 100 was stamped two and a half rows before.
    assert given[0, 100].tolist() == [97.5, -97.5]
    assert given[len(segments), 100].tolist() == [101.0, -101.0]
    assert given[0, 0, 0] == segments.action[0, 0, 0]  # before its first row it is held
    assert given[len(segments), -1, 0] == segments.action[0, -1, 0]  # and after its last


def test_the_start_of_a_late_sensor_is_taken_from_what_it_reports_later(quiet):
    late = ParameterSets({"sensor_latency": {"dead_time": torch.tensor([0.04])}})
    simulation = Simulation(single_track)
    right, wrong = simulation.residuals(quiet[1], late), simulation.residuals(quiet[1])
    assert float(right[..., :2].abs().max()) < 0.02
    assert float(wrong.square().mean()) > 10 * float(right.square().mean())


def test_a_start_error_moves_the_path_by_as_much(quiet):
    error = torch.zeros(2, 6)
    error[1, 1] = 0.1  # to the left
    residual = Simulation(single_track).residuals(quiet[0], start_error=error)
    moved = residual[1] - residual[0]
    torch.testing.assert_close(moved, error[1].expand(4, 10, 6), atol=2e-4, rtol=0)


def test_a_simulator_with_effects_keeps_them_when_it_is_given_parameters(quiet, tmp_path):
    file = tmp_path / "late.yaml"
    file.write_text("engine: single_track\neffects: {sensor_latency: {dead_time: 0.04}}\n")
    simulator = make_simulator(file, 2)
    mass = {"mass": torch.tensor([1.5, 2.0])}
    env, stack = augmented(simulator, {"viscous_drag": {"rate": torch.ones(2)}}, mass)
    # The drag acts on the motion before the sensor shows it, though the sensor was there first.
    assert [effect.name for effect in stack] == ["viscous_drag", "sensor_latency"]
    assert env.base_env.values["mass"].tolist() == [1.5, 2.0]
    assert [effect.name for effect in effects_of(simulator)] == ["sensor_latency"]

    neutral = {"mass": torch.tensor([single_track(1).declared["mass"].value])}
    residual = Simulation(lambda cars: make_simulator(file, cars)).residuals(
        quiet[1], ParameterSets(parameters=neutral)
    )
    assert float(residual[..., :2].abs().max()) < 0.02


def test_an_effect_that_is_there_already_and_a_task_are_refused(tmp_path):
    file = tmp_path / "late.yaml"
    file.write_text("engine: hold\neffects: {steering_dead_time: {dead_time: 0.04}}\n")
    more = {"steering_dead_time": {"dead_time": torch.tensor([0.1])}}
    with pytest.raises(ValueError, match="steering_dead_time already"):
        augmented(make_simulator(file, 1), more, {})
    with pytest.raises(ValueError, match="effects over its engine, not"):
        augmented(make_env(make_engine("hold", 1)), {}, {})


def test_linear_steps_of_a_late_sensor_are_those_of_its_rollout(quiet):
    late = ParameterSets({"sensor_latency": {"dead_time": torch.tensor([0.04])}})
    simulation = Simulation(single_track, every=1)
    rolled = simulation.readings(quiet[1], late)[0]
    steps = [step.read for step in simulation.linear_steps(quiet[1], late)]
    assert_close(torch.stack(steps, 1), rolled, atol=1e-4, rtol=0)
