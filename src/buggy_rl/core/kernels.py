"""A function of tensors, run from its compiled package where there is one and else by PyTorch.

Of a few hundred cars an operation of PyTorch takes microseconds whatever it does, and a step of a
car has hundreds. Compiled into one call they take as long as their arithmetic. Both give the same
numbers to rounding, but not to the last bit. Compiling needs a C++ compiler and a minute or two, so
it is done once, by `scripts/compile.py`. A package holds for the source and the processor that it
was made of and no other.

A package has the batch as the last dimension of all arguments, contiguous in memory: only so does
the compiler make vector instructions of it. `run` brings arguments into this layout; results that
`vehicle.columns` made have it already, so that kernels one after another copy nothing.

Source: `torch.export` and `torch._inductor.aoti_compile_and_package`, PyTorch documentation.
"""

import hashlib
import os
import platform
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from buggy_rl.core.config import load_named

FOLDER = "BUGGY_RL_KERNELS"
"""Environment variable: the folder of the packages, where it is not `CACHE`; empty for none."""
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "buggy_rl"
"""Folder of the packages by default."""
SOURCE = Path(__file__).parents[1]
MADE_OF = ("core/kernels.py", "simulators", "effects", "core/vehicle.py")
"""What kernels follow from, whole: a package too many is made anew rather than one too few."""


@dataclass(frozen=True, eq=False)
class Kernel:
    """A pure function of float32 tensors whose batch is one dimension of at least two."""

    name: str
    function: Callable[..., tuple[Tensor, ...]]
    example: Callable[[int], tuple[Tensor, ...]]
    """Arguments for a batch of n."""
    batch: tuple[int | None, ...]
    """Dimension of the batch of each argument; None where it has none."""

    def fastest(self, row: Tensor) -> Callable[..., Sequence[Tensor]]:
        """The package if it is `ready`, else the function."""
        return self.run if self.ready(row) else self.function

    def ready(self, row: Tensor) -> bool:
        """Whether its package is there and takes a batch like `row`, which has a value per car."""
        return (
            not torch.compiler.is_compiling()  # traced into another package
            and row.dim() == 1
            and len(row) > 1
            and row.dtype == torch.float32
            and row.device.type == "cpu"
            and not torch.is_grad_enabled()
            and _package(self, os.environ.get(FOLDER, str(CACHE))) is not None
        )

    def run(self, *arguments: Tensor) -> Sequence[Tensor]:
        """Runs the package, which must be `ready`, on arguments like those of `example`."""
        package = _package(self, os.environ.get(FOLDER, str(CACHE)))
        assert package is not None
        return package(self._batch_last(arguments))

    def _batch_last(self, arguments: Sequence[Tensor]) -> list[Tensor]:
        return [
            (a if dim is None or dim == a.dim() - 1 else a.movedim(dim, -1)).contiguous()
            for a, dim in zip(arguments, self.batch, strict=True)
        ]

    def file(self, folder: Path) -> Path:
        """File of the compiled kernel."""
        return folder / f"{self.name}-{kernel_digest()}.pt2"

    def compile(self, folder: Path) -> Path:
        """Makes the package.

        Raises:
            RuntimeError: There is no C++ compiler, or it refuses.
        """
        import torch._inductor.config as inductor

        arguments = self._batch_last(self.example(64))
        cars = torch.export.Dim("cars", min=2)
        batch = zip(self.batch, arguments, strict=True)
        shapes = tuple(None if dim is None else {a.dim() - 1: cars} for dim, a in batch)
        folder.mkdir(parents=True, exist_ok=True)
        written = self.file(folder).with_suffix(f".{os.getpid()}.pt2")
        # One thread: cases run beside each other, and sums keep their order.
        with torch.no_grad(), inductor.patch({"cpp.threads": 1}), warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # of PyTorch, about itself
            program = torch.export.export(_Module(self), tuple(arguments), dynamic_shapes=(shapes,))
            torch._inductor.aoti_compile_and_package(program, package_path=str(written))
        os.replace(written, self.file(folder))
        return self.file(folder)


class _Module(torch.nn.Module):
    """The function of a kernel as `torch.export` takes it, of arguments with the batch last."""

    def __init__(self, kernel: Kernel) -> None:
        super().__init__()
        self.kernel = kernel

    def forward(self, *arguments: Tensor) -> tuple[Tensor, ...]:
        given = (
            a if dim is None else a.movedim(-1, dim)
            for a, dim in zip(arguments, self.kernel.batch, strict=True)
        )
        return self.kernel.function(*given)


@cache
def kernel_digest() -> str:
    """Digest of the source, PyTorch and the processor."""
    parts = [torch.__version__, platform.machine(), _instructions()]
    for place in MADE_OF:
        path = SOURCE / place
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
        parts += [file.read_text(encoding="utf-8") for file in files]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _instructions() -> str:
    """Instructions of the processor: a package may use all, and another processor have fewer."""
    about = Path("/proc/cpuinfo")
    lines = about.read_text(errors="replace").splitlines() if about.exists() else []
    flags = [line for line in lines if line.lower().startswith(("flags", "features"))]
    return flags[0] if flags else torch.backends.cpu.get_cpu_capability()


@cache
def _package(kernel: Kernel, folder: str) -> Callable[[list[Tensor]], list[Tensor]] | None:
    if not folder or not Path(folder).is_dir():
        return None
    if not kernel.file(Path(folder)).is_file():
        again = "python scripts/compile.py" + ("" if folder == str(CACHE) else f" output={folder}")
        warnings.warn(
            f"{folder} holds no {kernel.name} of this source, which runs by PyTorch, slower: "
            f"{again} makes it",
            stacklevel=2,
        )
        return None
    file = str(kernel.file(Path(folder)))
    # Not by `aoti_load_package`: it compiles a program to ask what the processor is, which takes a
    # second and is in the digest. One thread, one runner, of a file with the default name, no GPU.
    aoti: Any = torch._C._aoti  # type: ignore[attr-defined]
    return aoti.AOTIModelPackageLoader(file, "model", True, 1, -1).run


KERNELS = (
    "buggy_rl.simulators.reference.car:KERNEL",
    "buggy_rl.simulators.reference.car:BRAKED_KERNEL",
    "buggy_rl.simulators.bicycle.single_track:KERNEL",
    "buggy_rl.effects.motion.base:CENTRED",
    "buggy_rl.effects.motion.base:MEAN_ACCELERATION",
    "buggy_rl.effects.motion.base:MOVED",
    "buggy_rl.effects.tyre.change:REAR_DRIVEN",
    "buggy_rl.effects.tyre.change:ALL_DRIVEN",
    "buggy_rl.effects.tyre.change:REAR_DRIVEN_TWO_WAY",
    "buggy_rl.effects.tyre.stiffness:REAR_DRIVEN",
    "buggy_rl.effects.tyre.stiffness:ALL_DRIVEN",
    "buggy_rl.effects.tyre.stiffness:REAR_DRIVEN_TWO_WAY",
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
