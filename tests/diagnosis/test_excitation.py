from dataclasses import replace
from functools import partial

import pytest
import torch

from buggy_rl import keys
from buggy_rl.diagnosis.excitation import deciding, suggestions, weak
from buggy_rl.diagnosis.fit import Fitted
from buggy_rl.diagnosis.library import Library
from buggy_rl.diagnosis.manoeuvres import MANOEUVRES
from buggy_rl.diagnosis.rollouts import Player
from buggy_rl.diagnosis.stretches import stretches
from buggy_rl.engines import make_engine
from tests.drives import counting_drive


def driven(vx, yaw_rate, drive, steering, yaw=0.0, rows=4000):
    """Stretches of a drive that is all alike but for the directions it goes in."""
    recording = counting_drive("a", rows)
    data = recording.data
    data[keys.VELOCITY] = torch.tensor([vx, 0.0, yaw_rate]).repeat(rows, 1)
    data[keys.ACTION] = torch.tensor([2 * drive - 1, steering]).repeat(rows, 1)
    data[keys.POSE] = torch.zeros(rows, 3)
    data[keys.POSE][:, 2] = yaw * torch.arange(rows) * 0.01
    return stretches([recording], 1.0, 1.0)


def hidden(cut):
    """What is hardly driven, by its first words."""
    return {line.partition(" hardly driven")[0].partition(" driven:")[0] for line in weak(cut)}


def test_a_steady_fast_left_bend_is_shown_and_all_else_is_missed():
    # 3 m/s at 2 rad/s is 6 m/s^2; turning on for 40 s passes through all directions.
    assert hidden(driven(3.0, 2.0, 0.7, 0.8, yaw=2.0)) == {
        "below 1 m/s",
        "coasting without drive",
        "hard right turns",
        "quick steering",
        "going straight",
    }


def test_rolling_slowly_straight_ahead_shows_only_that():
    missed = hidden(driven(0.8, 0.0, 0.0, 0.0, rows=2000))
    assert {"more than 0.6 of full drive", "above 2 m/s", "hard left turns"} <= missed
    assert not missed & {"below 1 m/s", "coasting without drive", "going straight"}
    words = " ".join(weak(driven(0.8, 0.0, 0.0, 0.0, rows=2000)))
    assert "not all directions driven: hides floor_slope, wind" in words
    assert "less than 30 s at a stretch: hides battery_sag" in words
    assert "battery_sag" not in " ".join(weak(driven(0.8, 0.0, 0.0, 0.0, rows=4000)))


def test_manoeuvres_can_be_driven_and_have_names_of_their_own():
    assert len({m.name for m in MANOEUVRES}) == len({m.words for m in MANOEUVRES}) == 12
    for manoeuvre in MANOEUVRES:
        actions = manoeuvre.actions(0.01)
        assert actions.shape == (50 + round(100 * manoeuvre.seconds), 2)
        assert (actions.abs() <= 1).all()
        assert (actions[:50] == torch.tensor([-1.0, 0.0])).all()  # half a second at rest
        assert float(actions[50:, 0].max()) > -0.7  # then it is driven


def fitted(library, cause, value):
    own = library.unknowns([cause])
    place = [own[0].parameter.coordinate(value), 0.0]
    return Fitted((cause,), own, torch.tensor(place, dtype=torch.float64), torch.empty(0))


@pytest.mark.parametrize(
    ("cause", "values", "expected"),
    [
        ("steering_gain", (0.7, 1.0), "slalom"),  # on a straight both are alike
        ("throttle_gain", (0.7, 1.0), "full_throttle"),
    ],
)
def test_the_manoeuvre_that_decides_is_the_one_in_which_answers_differ(
    cause, values, expected, monkeypatch
):
    def chosen(manoeuvre):
        return replace(manoeuvre, seconds=1.0)

    few = [chosen(m) for m in MANOEUVRES if m.name in ("full_throttle", "creep", "slalom")]
    monkeypatch.setattr("buggy_rl.diagnosis.excitation.MANOEUVRES", few)
    library = Library([cause])
    pair = [fitted(library, cause, value) for value in values]
    noise = torch.full((6,), 0.01)
    player = Player(partial(make_engine, "kinematic"))
    manoeuvre, size = deciding(player, library, *pair, noise, 0.01)
    assert manoeuvre.name == expected
    assert size > 5
    [words] = suggestions(player, library, [tuple(pair)], noise, 0.01)
    assert words == f"{manoeuvre.words} (tells {cause} from {cause}, by {size:.0f} times the noise)"
