"""Runs `buggy_rl.commands.fit_mujoco`, which says what it does."""

from buggy_rl.commands.fit_mujoco import main
from buggy_rl.core.config import run

if __name__ == "__main__":
    run(main)
