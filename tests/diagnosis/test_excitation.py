import torch

from buggy_rl.core import keys
from buggy_rl.diagnosis.answer.experiments import weak
from buggy_rl.diagnosis.answer.manoeuvres import MANOEUVRES
from buggy_rl.estimation.segments import cut_segments
from tests.drives import counting_drive


def seen(vx, yaw_rate, drive, steering, yaw=0.0, rows=4000):
    """Segments of a drive that is all alike but for the directions it goes in."""
    recording = counting_drive("a", rows)
    data = recording.data
    data[keys.VELOCITY] = torch.tensor([vx, 0.0, yaw_rate]).repeat(rows, 1)
    data[keys.ACTION] = torch.tensor([2 * drive - 1, steering]).repeat(rows, 1)
    data[keys.POSE] = torch.zeros(rows, 3)
    data[keys.POSE][:, 2] = yaw * torch.arange(rows) * 0.01
    return cut_segments([recording], 1.0, 1.0)


def hidden(segments):
    """What is hardly driven, by its first words."""
    return {line.partition(" hardly driven")[0].partition(" driven:")[0] for line in weak(segments)}


def test_a_steady_fast_left_bend_is_shown_and_all_else_is_missed():
    # 3 m/s at 2 rad/s is 6 m/s^2; turning on for 40 s passes through all directions.
    assert hidden(seen(3.0, 2.0, 0.7, 0.8, yaw=2.0)) == {
        "below 1 m/s",
        "coasting without drive",
        "hard right turns",
        "quick steering",
        "going straight",
    }


def test_rolling_slowly_straight_ahead_shows_only_that():
    missed = hidden(seen(0.8, 0.0, 0.0, 0.0, rows=2000))
    assert {"more than 0.6 of full drive", "above 2 m/s", "hard left turns"} <= missed
    assert not missed & {"below 1 m/s", "coasting without drive", "going straight"}
    words = " ".join(weak(seen(0.8, 0.0, 0.0, 0.0, rows=2000)))
    assert "not all directions driven: hides floor_slope, wind" in words
    assert "less than 30 s of one recording: hides battery_sag" in words
    assert "battery_sag" not in " ".join(weak(seen(0.8, 0.0, 0.0, 0.0, rows=4000)))


def test_manoeuvres_can_be_driven_and_have_names_of_their_own():
    assert len({m.name for m in MANOEUVRES}) == len({m.words for m in MANOEUVRES}) == 12
    for manoeuvre in MANOEUVRES:
        actions = manoeuvre.actions(0.01)
        assert actions.shape == (50 + round(100 * manoeuvre.seconds) + 100, 2)
        assert (actions.abs() <= 1).all()
        assert (actions[:50] == torch.tensor([-1.0, 0.0])).all()  # half a second at rest
        assert (actions[-100:] == torch.tensor([-1.0, 0.0])).all()  # and rolls for one at last
        assert float(actions[50:, 0].max()) > -0.7  # between them it is driven
