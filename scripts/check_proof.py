"""Runs `buggy_rl.commands.check_proof`, which says what it does."""

from buggy_rl.commands.check_proof import main
from buggy_rl.core.config import run

if __name__ == "__main__":
    run(main)
