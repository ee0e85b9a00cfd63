"""A simulator that draws its cars, as a file that every script takes as a simulator."""

from collections.abc import Callable
from pathlib import Path

from torchrl.envs import EnvBase

from buggy_rl.transfer.parameter_posterior import undecided
from buggy_rl.transfer.plan import TransferConfig
from buggy_rl.transfer.randomised import randomised

SOURCE = '''"""{simulator}, {name}; written by scripts/transfer.py."""

from functools import partial

from {module} import {name}

make = partial({name}, {simulator!r})
'''


def write_factory(draw: Callable[..., EnvBase], simulator: str, file: Path) -> None:
    """Writes `FILE:make`.

    Args:
        draw: Function of a module, of (simulator, batch_size, device).
        simulator: Its first argument.
        file: To be written.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    text = SOURCE.format(simulator=simulator, module=draw.__module__, name=draw.__name__)
    file.write_text(text)


def write_factories(config: TransferConfig) -> None:
    """Writes those of every arm whose cars differ."""
    for arm, car in config.places():
        if (file := config.factory(arm, car)) is not None:
            draw = randomised if arm == "randomised" else undecided
            write_factory(draw, config.made_from(arm, car), file)
