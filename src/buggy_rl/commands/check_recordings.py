"""Reads recordings as every other script does; prints which are usable and what was cut.

    python scripts/check_recordings.py drives/ columns=configs/columns/dart.yaml car=dart

Exit code 0: all recordings are usable; 1: some were refused; 2: none is usable.
"""

import argparse
import sys
from difflib import get_close_matches
from pathlib import Path
from typing import Any

SETTINGS: dict[str, Any] = {"columns": None, "dt": 0.01, "car": ""}


def main() -> int:
    """Checks the recordings named on the command line."""
    arguments = _parse()
    import torch

    from buggy_rl.diagnosis.answer.other_sensors import other_sensors
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.recordings import load_recordings
    from buggy_rl.recordings.loading import telling

    torch.set_num_threads(1)
    try:
        recordings, refusals = load_recordings(
            arguments.paths,
            arguments.columns,
            arguments.dt,
            car=arguments.car,
            progress=lambda found: tqdm(found, unit="recording", disable=len(found) < 5),
        )
    except ValueError as error:  # the column map or dt
        print(error, file=sys.stderr)
        return 2
    _print_table(recordings)
    for recording in recordings:
        shown = recording.notes if arguments.notes else telling(recording.notes)
        if shown:
            print("\n".join([f"\n{recording.name}", *(f"  {note}" for note in shown)]))
    for finding in other_sensors(recordings):
        print(f"measured beside the pose: {finding.line()}")
    for refusal in refusals:
        print(f"refused: {refusal}")
    seconds = sum(recording.duration for recording in recordings)
    print(f"{len(recordings)} recordings usable, {seconds:.1f} s; {len(refusals)} refused")
    if not recordings:
        return 2
    return 1 if refusals else 0


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("paths", nargs="+", help="files, folders, patterns, and key=value")
    parser.add_argument(
        "--notes", action="store_true", help="also print how sound recordings were read"
    )
    arguments = parser.parse_intermixed_args()
    settings = dict(SETTINGS)
    for word in list(arguments.paths):
        key, equals, value = word.partition("=")
        if equals and key in settings:
            settings[key] = value
            arguments.paths.remove(word)
        elif equals and key.isidentifier() and not Path(word).exists():
            meant = "".join(f"; did you mean {name}=?" for name in get_close_matches(key, settings))
            parser.error(f"{word}: no such file, nor a setting: {', '.join(settings)}{meant}")
    try:
        settings["dt"] = float(settings["dt"])
    except ValueError:
        parser.error(f"dt={settings['dt']}: write a number of seconds, such as dt=0.01")
    if not arguments.paths:
        parser.error("name at least one file, folder or pattern")
    for key, value in settings.items():
        setattr(arguments, key, value)
    return arguments


def _print_table(recordings) -> None:
    width = max(map(len, ["recording", *(recording.name for recording in recordings)]))
    print(f"{'recording':{width}}  seconds  segments  top speed  notes")
    for recording in recordings:
        data = recording.data
        speed = data["velocity"][:, :2].norm(dim=-1).max()
        segments = int(data["segment"][-1]) + 1
        numbers = f"{recording.duration:7.1f}  {segments:8d}  {speed:9.2f}"
        print(f"{recording.name:{width}}  {numbers}  {len(recording.notes):5d}")


if __name__ == "__main__":
    sys.exit(main())
