"""Runs `buggy_rl.commands.demo`, which says what it does."""

from buggy_rl.commands.demo import main

if __name__ == "__main__":
    main()
