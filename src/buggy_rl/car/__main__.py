"""Drives the car: `python -m buggy_rl.car CONFIG.json [PARENT]`, on the car's computer."""

import sys
from typing import List

from buggy_rl.car.clock import LOOP, take_priority
from buggy_rl.car.drive import drive_car, load_config
from buggy_rl.car.output import UnblockedOutput
from buggy_rl.car.stopping import Parent


def main(arguments: List[str]) -> int:
    """Returns the exit status: 0 after a drive that ended well, 1 after one that did not, 2 before.

    Args:
        arguments: The config file, and the process that the drive ends with, if there is one.
    """
    if len(arguments) not in (1, 2) or arguments[0] in ("-h", "--help"):
        print("usage: python -m buggy_rl.car CONFIG.json (docs/car.md)")
        return 0 if arguments[:1] in (["-h"], ["--help"]) else 2
    try:
        config = load_config(arguments[0])
        take_priority(LOOP)
        parent = Parent(int(arguments[1]) if arguments[1:] else 0)
        about = {"config": config._asdict()}
        summary = drive_car(config, about, lambda line: print(line, flush=True), parent)
    except (ValueError, OSError, ImportError) as error:
        print(error, file=sys.stderr)
        return 2
    print("\n".join(summary.lines()))
    return 0 if summary.neutral_confirmed and not summary.by_loop else 1


if __name__ == "__main__":
    with UnblockedOutput():  # a terminal that takes no more does not hold up the car
        status = main(sys.argv[1:])
    sys.exit(status)
