r"""Drives a simulator about a room and writes the recordings of a simulated tracking camera.

    python scripts/record.py configs/record_sample.yaml
    python scripts/record.py output=runs/drives drives=20 seconds=60 seed=7 format=parquet
    python scripts/record.py output=runs/late faults.steering_dead_time.dead_time=0.06 \
        camera.latency=0.03 sealed=runs/late_answer
    python scripts/record.py output=runs/brakes driver=manoeuvring \
        options.command=throttle_brake_reverse
    python scripts/record.py output=runs/large driver=manoeuvring car=autorally \
        options.command=throttle_brake_reverse camera.velocity_noise=0.07

Writes OUTPUT/PREFIX_00.csv and so on, one recording a drive, and the config beside them, or to
SEALED for a blind test; for a command other than a one-way throttle also OUTPUT/columns.yaml, the
column map to read them with. The room is 8 m wide, for another `car` as much wider.
src/buggy_rl/simulators/reference/faults.py lists the faults of the reference car.
"""

from pathlib import Path
from typing import cast

from buggy_rl.core.config import from_command_line, run, save_run


def main() -> None:
    """Drives all cars in one batch, then measures and writes each drive."""
    config = from_command_line(__doc__, "buggy_rl.policies.controllers.recording:RecordConfig")

    import torch
    from tensordict import TensorDict

    from buggy_rl.core import keys
    from buggy_rl.core.longitudinal import ONE_WAY, declared_by
    from buggy_rl.core.vehicle import CONTROL_PERIOD
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.policies.controllers.recording import make_driver, recorded_steps
    from buggy_rl.recordings import Recording, save_command, save_recording
    from buggy_rl.recordings.camera import Camera
    from buggy_rl.task.env import make_simulator

    torch.set_num_threads(1)
    folder = Path(config.output)
    about = Path(config.sealed or config.output)
    if config.sealed and about.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"sealed={about} is inside output={folder}: name a folder elsewhere")
    engine = make_simulator(config.simulator, config.drives, **config.of_engine)
    camera = Camera(config.camera, config.seed)
    steps = round(config.seconds / CONTROL_PERIOD)
    rows = recorded_steps(engine, make_driver(config, engine), steps)
    rows = list(tqdm(rows, "driving", steps, unit="step"))
    drives = cast(TensorDict, TensorDict.stack(rows, 1))

    save_run(config, about)
    folder.mkdir(parents=True, exist_ok=True)
    for index, drive in enumerate(drives.unbind(0)):
        name = f"{config.prefix}_{index:02d}"
        data = camera.recorded(drive)
        recording = Recording(name, data, CONTROL_PERIOD, command=declared_by(engine))
        save_recording(recording, folder / f"{name}.{config.format}")
    if declared_by(engine) != ONE_WAY:
        save_command(declared_by(engine), folder / "columns.yaml")
    farthest = float(drives[keys.POSE][..., :2].abs().max())
    print(
        f"{config.drives} drives of {config.seconds:g} s of {config.simulator!r} in {folder}; "
        f"largest |x| or |y| {farthest:.2f} m"
    )


if __name__ == "__main__":
    run(main)
