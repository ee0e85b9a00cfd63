"""All kernels, and the configuration of the script that compiles them."""

from dataclasses import dataclass

from buggy_rl.config import load_named
from buggy_rl.kernels.kernel import Kernel

KERNELS = (
    "buggy_rl.engines.reference.car:KERNEL",
    "buggy_rl.engines.single_track:KERNEL",
    "buggy_rl.effects.tyre.change:REAR_DRIVEN",
    "buggy_rl.effects.tyre.change:ALL_DRIVEN",
)


@dataclass
class CompileConfig:
    """Options of `scripts/compile.py`."""

    output: str = "build/kernels"
    """Folder of the packages; name it in BUGGY_RL_KERNELS to use them."""


def kernels() -> list[Kernel]:
    """The two engines; the tyre effects of rear-wheel and of four-wheel drive."""
    return [load_named(name) for name in KERNELS]
