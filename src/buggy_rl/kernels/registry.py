"""All kernels, and the configuration of the script that compiles them."""

from dataclasses import dataclass

from buggy_rl.config import load_named
from buggy_rl.kernels.kernel import Kernel

KERNELS = (
    "buggy_rl.engines.reference.car:KERNEL",
    "buggy_rl.engines.reference.car:BRAKED_KERNEL",
    "buggy_rl.engines.bicycle.single_track:KERNEL",
    "buggy_rl.effects.motion.step:CENTRED",
    "buggy_rl.effects.motion.step:MEAN_ACCELERATION",
    "buggy_rl.effects.motion.step:MOVED",
    "buggy_rl.effects.tyre.change:REAR_DRIVEN",
    "buggy_rl.effects.tyre.change:ALL_DRIVEN",
    "buggy_rl.effects.tyre.change:REAR_DRIVEN_TWO_WAY",
    "buggy_rl.effects.tyre.slip:REAR_DRIVEN",
    "buggy_rl.effects.tyre.slip:ALL_DRIVEN",
    "buggy_rl.effects.tyre.slip:REAR_DRIVEN_TWO_WAY",
)


@dataclass
class CompileConfig:
    """Options of `scripts/compile.py`."""

    output: str = ""
    """Folder of the packages; empty for the user's cache, where every script looks for them.
    Another one is to be named in BUGGY_RL_KERNELS."""


def kernels() -> list[Kernel]:
    """Two engines, one with brakes too; a step of effects on the motion; tyre effects."""
    return [load_named(name) for name in KERNELS]
