"""An MJCF car as a simulator.

python scripts/diagnose.py simulator=examples/mjcf_car.py:make "recordings=[FOLDER]" output=mine
"""

from pathlib import Path

from buggy_rl import from_mjcf

make = from_mjcf(
    Path(__file__).with_name("car.xml"),
    drive=["left_motor", "right_motor"],  # throttle -1 is control 0, +1 the end of the ctrlrange
    steering=["left_servo", "right_servo"],  # positive to the left
    body="chassis",  # on a free joint; x points forward
)
