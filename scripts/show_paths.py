"""Runs `buggy_rl.commands.show_paths`, which says what it does."""

from buggy_rl.commands.show_paths import main
from buggy_rl.core.config import run

if __name__ == "__main__":
    run(main)
