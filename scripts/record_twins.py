"""Runs `buggy_rl.commands.record_twins`, which says what it does."""

from buggy_rl.commands.record_twins import main
from buggy_rl.core.config import run

if __name__ == "__main__":
    run(main)
