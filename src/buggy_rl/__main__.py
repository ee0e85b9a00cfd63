"""`buggy-rl VERB OPTIONS`, also as `python -m buggy_rl VERB OPTIONS`."""

import sys

from buggy_rl import commands
from buggy_rl.core.config import run


def main() -> None:
    """Runs the verb that the command line names."""
    run(lambda: commands.main(sys.argv[1:]))


if __name__ == "__main__":
    main()
