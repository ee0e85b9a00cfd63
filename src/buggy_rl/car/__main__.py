"""Drives the car: `python -m buggy_rl.car CONFIG.json`, on the car's computer."""

import sys
from typing import List

from buggy_rl.car.config import load_config
from buggy_rl.car.drive import drive
from buggy_rl.car.priority import LOOP, take_priority


def main(arguments: List[str]) -> int:
    """Returns the exit status: 0 after a drive that ended well, 1 after one that did not, 2 before.

    Args:
        arguments: The config file.
    """
    if len(arguments) != 1 or arguments[0] in ("-h", "--help"):
        print("usage: python -m buggy_rl.car CONFIG.json (docs/car.md)")
        return 0 if arguments[:1] in (["-h"], ["--help"]) else 2
    try:
        config = load_config(arguments[0])
        take_priority(LOOP)
        summary = drive(config, {"config": config._asdict()}, lambda line: print(line, flush=True))
    except (ValueError, OSError, ImportError) as error:
        print(error, file=sys.stderr)
        return 2
    print("\n".join(summary.lines()))
    return 0 if summary.neutral_confirmed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
