import pytest
import torch

from buggy_rl.engines import make_engine
from buggy_rl.estimation.rollout import Player, effects_of, explained
from buggy_rl.estimation.segments import stretches
from buggy_rl.task.env import make_env, make_simulator
from tests.diagnosis.planted import QUIET, planted_drives, single_track
from tests.drives import counting_drive


@pytest.fixture(scope="module")
def quiet():
    """Stretches of a car without and of one with a late sensor, measured without noise."""
    cases = [{}, {"sensor_latency": {"dead_time": 0.04}}]
    return [stretches(d, 1.0, 1.0) for d in planted_drives(cases, 1, 5.0, quality=QUIET)]


def sets(*values):
    return {"steering_gain": {"gain": torch.tensor(values)}}


def test_a_simulator_foretells_its_own_drive(quiet):
    gap = Player(single_track).play(quiet[0], {})
    assert gap.shape == (1, 4, 10, 6)
    # Sharp commands bend the velocities by more than a parabola follows: not exactly zero.
    assert float(gap[..., :2].abs().max()) < 0.02
    wrong = Player(single_track).play(quiet[0], sets(0.7))
    assert float(wrong.square().mean()) > 100 * float(gap.square().mean())


@pytest.mark.parametrize(
    ("effect", "value"),
    [("steering_rate_limit", {"rate": 0.8}), ("steering_lag", {"time_constant": 0.5})],
)
def test_what_a_slow_servo_was_told_long_before_a_stretch_is_known(effect, value):
    # From lock to lock it takes longer than the warm-up: begun there, it would be on its way still.
    [drives] = planted_drives([{effect: value}], 1, 6.0, quality=QUIET)
    cut = stretches(drives, 1.0, 1.0)
    values = {effect: {name: torch.tensor([number]) for name, number in value.items()}}
    gap = Player(single_track).play(cut, values)
    assert float(gap[:, 1:, :, 5].abs().max()) < 0.15  # [rad/s]


def test_each_set_is_a_row_as_if_it_were_alone(quiet):
    player = Player(single_track)
    both = player.play(quiet[0], sets(0.8, 1.2), {"mass": torch.tensor([1.5, 2.0])})
    for index, (gain, mass) in enumerate(((0.8, 1.5), (1.2, 2.0))):
        alone = player.play(quiet[0], sets(gain), {"mass": torch.tensor([mass])})
        torch.testing.assert_close(both[index], alone[0], atol=1e-5, rtol=1e-5)


def test_batches_too_large_for_the_memory_are_played_in_parts(quiet, monkeypatch):
    whole = Player(single_track).play(quiet[0], sets(0.8, 1.0, 1.2))
    monkeypatch.setattr("buggy_rl.estimation.rollout.MOST_CARS", 5)  # one set of 4 stretches each
    parts = Player(single_track).play(quiet[0], sets(0.8, 1.0, 1.2))
    torch.testing.assert_close(parts, whole, atol=1e-5, rtol=1e-5)


def test_an_offset_of_the_clock_shifts_a_ramp_by_as_much():
    from buggy_rl.estimation.rollout import _commanded

    cut = stretches([counting_drive("a", 231)], 1.0, 1.0)  # throttle is the row
    given = _commanded(cut, torch.tensor([0.025, -0.01]), 2)
    # 25 ms late: what reaches the car at row 100 was stamped two and a half rows before.
    assert given[0, 100].tolist() == [97.5, -97.5]
    assert given[len(cut), 100].tolist() == [101.0, -101.0]
    assert given[0, 0, 0] == cut.action[0, 0, 0]  # before its first row it is held


def test_the_start_of_a_late_sensor_is_taken_from_what_it_reports_later(quiet):
    effect = {"sensor_latency": {"dead_time": torch.tensor([0.04])}}
    player = Player(single_track)
    right, wrong = player.play(quiet[1], effect), player.play(quiet[1], {})
    assert float(right[..., :2].abs().max()) < 0.02
    assert float(wrong.square().mean()) > 10 * float(right.square().mean())


def test_a_shift_of_the_start_moves_the_path_by_as_much(quiet):
    shift = torch.zeros(2, 6)
    shift[1, 1] = 0.1  # to the left
    gap = Player(single_track).play(quiet[0], {}, shift=shift)
    torch.testing.assert_close(gap[1] - gap[0], shift[1].expand(4, 10, 6), atol=2e-4, rtol=0)


def test_a_simulator_with_effects_keeps_them_when_it_is_given_parameters(quiet, tmp_path):
    file = tmp_path / "late.yaml"
    file.write_text("engine: single_track\neffects: {sensor_latency: {dead_time: 0.04}}\n")
    simulator = make_simulator(file, 2)
    mass = {"mass": torch.tensor([1.5, 2.0])}
    env, stack = explained(simulator, {"viscous_drag": {"rate": torch.ones(2)}}, mass)
    # The drag acts on the motion before the sensor shows it, though the sensor was there first.
    assert [effect.name for effect in stack] == ["viscous_drag", "sensor_latency"]
    assert env.base_env.values["mass"].tolist() == [1.5, 2.0]
    assert [effect.name for effect in effects_of(simulator)] == ["sensor_latency"]

    neutral = {"mass": torch.tensor([single_track(1).declared["mass"].value])}
    gap = Player(lambda cars: make_simulator(file, cars)).play(quiet[1], {}, neutral)
    assert float(gap[..., :2].abs().max()) < 0.02


def test_an_effect_that_is_there_already_and_a_task_are_refused(tmp_path):
    file = tmp_path / "late.yaml"
    file.write_text("engine: hold\neffects: {steering_dead_time: {dead_time: 0.04}}\n")
    more = {"steering_dead_time": {"dead_time": torch.tensor([0.1])}}
    with pytest.raises(ValueError, match="steering_dead_time already"):
        explained(make_simulator(file, 1), more, {})
    with pytest.raises(ValueError, match="effects over its engine, not"):
        explained(make_env(make_engine("hold", 1)), {}, {})
