r"""Lets a person drive a simulator in the browser, at 100 Hz in real time, and records the drive.

    python scripts/drive.py simulator=mujoco course=lap output=runs/human/lap_0.csv
    python scripts/drive.py simulator=runs/models/best.pt course=random driver=gamepad \
        output=runs/human/random_0.csv
    python scripts/drive.py simulator=kinematic course=none seconds=60 output=runs/human/free.csv
    python scripts/drive.py driver=scripted view=false output=runs/human/scripted_0.csv

Open the address that is printed. Arrows or WASD drive and steer, space is neutral, C changes the
camera, Enter starts. The recording is what every script reads; a note of who drove is beside it.

With car= the car's own runtime drives, watched by its safety rules (docs/car.md):

    python scripts/drive.py car=simulated policy=runs/x/car/policy.json course=lap output=runs/car
    python scripts/drive.py car=simulated simulated.faults.steering_dead_time.dead_time=0.06 \
        policy=pursuit pursuit.weave=0.5 seconds=45 output=runs/late
    python scripts/drive.py car=my_car.json
    python scripts/drive.py car=simulated --help
"""

import sys
from pathlib import Path

from buggy_rl.core.config import from_command_line, plain_values, run


def main() -> None:
    """Lets a person drive in the browser, or the runtime on a car."""
    if any(argument.startswith("car=") for argument in sys.argv[1:]):
        on_car()
    else:
        in_browser()


def on_car() -> None:
    """Starts the runtime, and the simulated car where that is driven."""
    config = from_command_line(__doc__, "buggy_rl.simulated_car.on_car:OnCarConfig")

    from buggy_rl.simulated_car.on_car import drive_on_car

    sys.exit(drive_on_car(config))


def in_browser() -> None:
    """Waits for the driver, counts down, drives, records."""
    config = from_command_line(__doc__, "buggy_rl.policies.people:DriveConfig")

    from contextlib import ExitStack

    import torch

    from buggy_rl.car.clock import Deadlines
    from buggy_rl.core.extras import needs
    from buggy_rl.core.files import write_json
    from buggy_rl.core.longitudinal import ONE_WAY, declared_by
    from buggy_rl.core.vehicle import CONTROL_PERIOD
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.policies import people as live_drive
    from buggy_rl.policies.human_table import DriveNote, note_file
    from buggy_rl.recordings import save_command
    from buggy_rl.recordings.saving import Recorder

    needs("websockets", "visual", "driving in the browser")
    from buggy_rl.visual.viewer.cockpit import Cockpit

    if config.view:
        needs("viser", "visual", "the view of the car (view=true)")
    torch.set_num_threads(config.threads)
    env = live_drive.drive_environment(config)
    with ExitStack() as stack:
        recorder = stack.enter_context(Recorder(config.output))
        cockpit = stack.enter_context(Cockpit(config, env))
        cockpit.wait_for_start(tqdm.write)
        note = DriveNote.of(config)
        write_json(note_file(config.output), plain_values(note))
        state, last = live_drive.start(env), None
        deadlines = Deadlines(CONTROL_PERIOD)
        driven = live_drive.live_steps(env, state, cockpit.input, config.steps, deadlines)
        for last in tqdm(driven, "driving", config.steps, unit="step", mininterval=0.5):
            recorder.write(last.time, last.values)
            cockpit.show(last)
        assert last is not None
        note = note.ended(last, deadlines)
        write_json(note_file(config.output), plain_values(note))
        cockpit.end(note)
    if declared_by(env) != ONE_WAY:
        save_command(declared_by(env), Path(config.output).with_suffix(".columns.yaml"))
    print(
        f"{config.output}: {note.waypoints} waypoints closed in {note.seconds:.2f} s by a "
        f"{note.driver} driver; {note.overruns} of {recorder.rows} steps late"
    )
    if note.slipped > 0:
        print(
            f"the simulator was too slow for real time: {note.slipped:.2f} s were lost, so the "
            "car was driven in slow motion"
        )


if __name__ == "__main__":
    run(main)
