"""Drives a simulator about an 8 m room and writes what a tracking camera would have recorded.

    python scripts/record.py configs/record_sample.yaml
    python scripts/record.py output=runs/drives drives=20 seconds=60 seed=7 format=parquet

Writes OUTPUT/PREFIX_00.csv and so on, each a recording as every other script reads it.
"""

from pathlib import Path

from buggy_rl.config import from_command_line, save_run

DECIMALS = 5  # of every column: 10 micrometres, a seventieth of the camera's noise


def main() -> None:
    """Drives all cars at once, then measures and writes drive by drive."""
    config = from_command_line(__doc__, "buggy_rl.drivers.room:RecordConfig")

    import torch
    from tensordict import TensorDict
    from tqdm import tqdm

    from buggy_rl import keys
    from buggy_rl.camera import Camera
    from buggy_rl.drivers.room import RoomDriver
    from buggy_rl.engines import make_engine
    from buggy_rl.recordings import save_recording
    from buggy_rl.vehicle import CONTROL_PERIOD

    torch.set_num_threads(1)
    folder = Path(config.output)
    engine = make_engine(config.simulator, config.drives)
    driver = RoomDriver(config.room, config.seed)
    pose = driver.start_pose(engine.batch_size)
    start = {keys.POSE: pose, keys.VELOCITY: torch.zeros_like(pose)}
    state = engine.reset(TensorDict(start, engine.batch_size))
    rows = []
    for _ in tqdm(range(round(config.seconds / CONTROL_PERIOD)), "driving", unit="step"):
        state = driver(state)
        rows.append(state.select(keys.POSE, keys.VELOCITY, keys.ACTION).clone())
        state = engine.step(state)["next"]

    save_run(config, folder)
    camera = Camera(config.camera, config.seed)
    for index, drive in enumerate(torch.stack(rows, 1)):
        name = f"{config.prefix}_{index:02d}"
        save_recording(measured(name, drive, camera), folder / f"{name}.{config.format}")
    farthest = max(float(row[keys.POSE][..., :2].abs().max()) for row in rows)
    print(
        f"{config.drives} drives of {config.seconds:g} s of {config.simulator!r} in {folder}; "
        f"at most {farthest:.2f} m from the middle of the room along a wall"
    )


def measured(name, drive, camera):
    """What the camera makes of a drive [T], as a Recording; dropped frames leave gaps."""
    import torch
    from tensordict import TensorDict

    from buggy_rl import keys
    from buggy_rl.recordings import Recording
    from buggy_rl.vehicle import CONTROL_PERIOD

    pose, velocity = camera.measure(drive[keys.POSE], drive[keys.VELOCITY], CONTROL_PERIOD)
    row = torch.nonzero(camera.arrived(len(drive)))  # (T', 1)
    columns = {keys.POSE: pose, keys.VELOCITY: velocity, keys.ACTION: drive[keys.ACTION]}
    data = {key: value.round(decimals=DECIMALS)[row[:, 0]] for key, value in columns.items()}
    data[keys.TIME] = (row.double() * CONTROL_PERIOD).round(decimals=DECIMALS)
    data[keys.SEGMENT] = (row[:, 0].diff(prepend=row[:1, 0]) > 1).cumsum(0)
    return Recording(name, TensorDict(data, len(row)), CONTROL_PERIOD)


if __name__ == "__main__":
    main()
