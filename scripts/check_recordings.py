"""Runs `buggy_rl.commands.check_recordings`, which says what it does."""

import sys

from buggy_rl.commands.check_recordings import main

if __name__ == "__main__":
    sys.exit(main())
