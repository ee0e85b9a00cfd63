"""Runs `buggy_rl.commands.demo`, which says what it does."""

from buggy_rl.commands.demo import main
from buggy_rl.core.config import run

if __name__ == "__main__":
    run(main)
