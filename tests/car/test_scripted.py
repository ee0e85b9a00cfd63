"""The person who is not there presses until the car is armed."""

from buggy_rl.car.human import Schedule, ScriptedPilot


def presses(pilot, seconds):
    """How often the button goes down."""
    held, count = False, 0
    for _ in range(round(seconds / 0.01)):
        pilot.command(0.01)
        count += pilot.hold_to_drive and not held
        held = pilot.hold_to_drive
    return count


def test_a_press_that_nothing_is_said_of_is_repeated():
    pilot = ScriptedPilot(Schedule(press_after=0.1))
    assert presses(pilot, 3.0) >= 8


def test_the_button_is_held_while_the_car_is_armed():
    pilot = ScriptedPilot(Schedule(press_after=0.1))
    presses(pilot, 0.15)
    pilot.show(True, "armed")
    assert presses(pilot, 3.0) == 1  # the one that it holds already
    assert pilot.hold_to_drive


def test_a_car_that_was_disarmed_is_armed_again_if_the_schedule_says_so():
    for again in (False, True):
        pilot = ScriptedPilot(Schedule(press_after=0.1, again=again))
        presses(pilot, 0.15)
        pilot.show(True, "armed")
        pilot.show(False, "the reading is frozen")
        assert not pilot.hold_to_drive
        assert bool(presses(pilot, 1.0)) == again
