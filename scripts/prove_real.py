"""Runs `buggy_rl.commands.prove_real`, which says what it does."""

from buggy_rl.commands.prove_real import main
from buggy_rl.core.config import run

if __name__ == "__main__":
    run(main)
