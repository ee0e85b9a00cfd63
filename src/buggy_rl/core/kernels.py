"""A function of tensors, run from its compiled package where there is one and else by PyTorch.

Of a few hundred cars an operation of PyTorch takes microseconds whatever it does, and a step of a
car has hundreds. Compiled into one call they take as long as their arithmetic. Both give the same
numbers to rounding, but not to the last bit. Compiling needs a C++ compiler and some 15 s of a core
a kernel, so it is done once, by `scripts/compile.py`. A package holds for the source and the
processor that it was made of and no other. Of several processes one compiles a package, and the
others wait for it.

A package has the batch as the last dimension of all arguments, contiguous in memory: only so does
the compiler make vector instructions of it. `run` brings arguments into this layout; results that
`vehicle.columns` made have it already, so that kernels one after another copy nothing.

Source: `torch.export` and `torch._inductor.aoti_compile_and_package`, PyTorch documentation.
"""

import fcntl
import hashlib
import os
import platform
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
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
LANES = 16  # float32 numbers of a vector instruction at most
Package = Callable[[list[Tensor]], list[Tensor]]
MADE_OF = ("core/kernels.py", "simulators", "effects", "core/vehicle.py")
"""What kernels follow from, whole: a package too many is made anew rather than one too few."""


@dataclass(frozen=True, eq=False)
class Kernel:
    """A pure function of float32 tensors whose batch is one dimension.

    Its package runs a multiple of `LANES` cars, a single one without a batch dimension too. The
    rest of a batch would be rounded otherwise than the full vectors: a car's path would depend on
    how many others are simulated, and an answer on the number of workers.
    """

    name: str
    function: Callable[..., tuple[Tensor, ...]]
    example: Callable[[int], tuple[Tensor, ...]]
    """Arguments for a batch of n."""
    batch: tuple[int | None, ...]
    """Dimension of the batch of each argument; None where it has none."""

    def fastest(self, row: Tensor) -> Callable[..., Sequence[Tensor]]:
        """What is `compiled` for cars like `row`, else the function."""
        return self.compiled(row) or self.function

    def compiled(self, row: Tensor) -> Callable[..., Sequence[Tensor]] | None:
        """What runs the package on arguments like those of `example`.

        With `times=n` it runs n times, the results in the place of the last arguments. None where
        there is no package, or where it does not take cars like `row`, which has a value per car.
        """
        if (
            torch.compiler.is_compiling()  # traced into another package
            or row.dim() > 1
            or row.numel() == 0
            or row.dtype != torch.float32
            or row.device.type != "cpu"
            or torch.is_grad_enabled()
        ):
            return None
        package = _package(self, os.environ.get(FOLDER, str(CACHE)))
        return None if package is None else partial(self._run, package)

    def _run(self, package: Package, *arguments: Tensor, times: int = 1) -> Sequence[Tensor]:
        first, dim, rank = self._first
        alone = arguments[first].dim() < rank
        if alone:
            each = zip(arguments, self.batch, strict=True)
            arguments = tuple(a if dim is None else a.unsqueeze(dim) for a, dim in each)
        count = arguments[first].shape[dim]
        given = self._batch_last(arguments, -count % LANES)
        found = package(given)
        for _ in range(times - 1):
            state = zip(found, self._batch_of_results, strict=True)
            given[-len(found) :] = [_last(r, dim).contiguous() for r, dim in state]
            found = package(given)
        if count % LANES == 0:
            return found
        results = zip(found, self._batch_of_results, strict=True)
        if alone:
            return [r.select(dim, 0) for r, dim in results]
        return [_last(r, dim)[..., :count].contiguous().movedim(-1, dim) for r, dim in results]

    @cached_property
    def _first(self) -> tuple[int, int, int]:
        """An argument that has a batch: its number, the batch's dimension, and how many it has."""
        number, dim = next((i, dim) for i, dim in enumerate(self.batch) if dim is not None)
        return number, dim, self.example(2)[number].dim()

    @cached_property
    def _batch_of_results(self) -> list[int]:
        """Dimension of the batch of each result: the one that depends on the number of cars."""
        with torch.no_grad():
            two, five = (self.function(*self.example(count)) for count in (2, 5))
        shapes = ((a.shape, b.shape) for a, b in zip(two, five, strict=True))
        return [next(i for i, n in enumerate(a) if n != b[i]) for a, b in shapes]

    def _batch_last(self, arguments: Sequence[Tensor], more: int = 0) -> list[Tensor]:
        """Arguments with the batch last, and the first car so many times more.

        Not zeros: where one of a vector is not finite, sines of the others are rounded otherwise.
        """
        each = [_last(a, dim) for a, dim in zip(arguments, self.batch, strict=True)]
        if not more:
            return [a.contiguous() for a in each]
        return [
            a.contiguous()
            if dim is None
            else torch.cat([a, a[..., :1].expand(*a.shape[:-1], more)], -1)
            for a, dim in zip(each, self.batch, strict=True)
        ]

    def file(self, folder: Path) -> Path:
        """File of the compiled kernel."""
        return folder / f"{self.name}-{kernel_digest()}.pt2"

    def compile(self, folder: Path) -> Path:
        """Makes the package unless it is there; waits for a process that is making it.

        Raises:
            RuntimeError: There is no C++ compiler, or it refuses.
        """
        folder.mkdir(parents=True, exist_ok=True)
        with open(self._lock(folder), "a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # until the file is closed, or the process ends
            if not self.file(folder).is_file():
                self._make(folder)
        return self.file(folder)

    def there(self, folder: Path) -> bool:
        """Whether the package is there, once no other process is making it."""
        if self.file(folder).is_file() or not self._lock(folder).is_file():
            return self.file(folder).is_file()
        with open(self._lock(folder)) as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                print(f"another process compiles {self.name}: waiting for it", file=sys.stderr)
                fcntl.flock(lock, fcntl.LOCK_SH)
        return self.file(folder).is_file()

    def _lock(self, folder: Path) -> Path:
        return self.file(folder).with_suffix(".lock")

    def _make(self, folder: Path) -> None:
        import torch._inductor.config as inductor

        arguments = self._batch_last(self.example(64))
        cars = torch.export.Dim("cars", min=2)
        batch = zip(self.batch, arguments, strict=True)
        shapes = tuple(None if dim is None else {a.dim() - 1: cars} for dim, a in batch)
        written = self.file(folder).with_suffix(f".{os.getpid()}.pt2")
        # One thread: cases run beside each other, and sums keep their order.
        with torch.no_grad(), inductor.patch({"cpp.threads": 1}), warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # of PyTorch, about itself
            program = torch.export.export(_Module(self), tuple(arguments), dynamic_shapes=(shapes,))
            torch._inductor.aoti_compile_and_package(program, package_path=str(written))
        os.replace(written, self.file(folder))


def _last(argument: Tensor, dim: int | None) -> Tensor:
    """An argument with its batch, dimension `dim`, as the last one."""
    rank = argument.dim()
    if dim is None or dim == rank - 1:
        return argument
    return argument.T if rank == 2 else argument.movedim(dim, -1)


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
def _package(kernel: Kernel, folder: str) -> Package | None:
    if not folder:
        return None
    if not kernel.there(Path(folder)):
        _tell_missing(kernel.name, folder)
        return None
    file = str(kernel.file(Path(folder)))
    # Not by `aoti_load_package`: it compiles a program to ask what the processor is, which takes a
    # second and is in the digest. One thread, one runner, of a file with the default name, no GPU.
    aoti: Any = torch._C._aoti  # type: ignore[attr-defined]
    return aoti.AOTIModelPackageLoader(file, "model", True, 1, -1).run


_MISSING: set[str] = set()  # folders of which it was said that they lack a package


def _tell_missing(name: str, folder: str) -> None:
    """Warns that PyTorch runs instead of a package; once a folder, since others may lack too."""
    if folder in _MISSING:
        return
    _MISSING.add(folder)
    again = "python scripts/compile.py" + ("" if folder == str(CACHE) else f" output={folder}")
    warnings.warn(
        f"{folder} holds no {name} of this source: what is not compiled runs by PyTorch, slower; "
        f"{again} compiles it, once, in a few minutes",
        stacklevel=2,
    )


KERNELS = (
    "buggy_rl.simulators.reference.car:KERNEL",
    "buggy_rl.simulators.reference.car:BRAKED_KERNEL",
    "buggy_rl.simulators.bicycle.single_track:KERNEL",
    *(
        f"buggy_rl.simulators.mujoco.closed_cars:{driven}"
        for driven in ("REAR_DRIVEN", "ALL_DRIVEN", "ALL_DRIVEN_TO_SPEED")
    ),
    "buggy_rl.effects.motion.base:CENTRED",
    "buggy_rl.effects.motion.base:MEAN_ACCELERATION",
    "buggy_rl.effects.motion.base:MOVED",
    *(
        f"buggy_rl.effects.tyre.{of}:{axles}_DRIVEN{ways}"
        for of in ("change", "stiffness")
        for ways in ("", "_TWO_WAY")
        for axles in ("REAR", "ALL", "FRONT")
    ),
)


@dataclass
class CompileConfig:
    """Options of `scripts/compile.py`."""

    output: str = ""
    """Folder of the packages; empty for the user's cache, where every script looks for them.
    Another one is to be named in BUGGY_RL_KERNELS."""
    only: list[str] = field(default_factory=list)
    """Names of kernels, which are compiled in this order; empty for all."""
    workers: int = 0
    """Processes that compile beside one another; 0 for one a core."""


def kernels(only: Sequence[str] = ()) -> list[Kernel]:
    """Two engines, one with brakes too; a step of effects on the motion; tyre effects.

    Args:
        only: Names of those wanted, in the order wanted; none for all.

    Raises:
        ValueError: There is no kernel of a name.
    """
    known = {kernel.name: kernel for kernel in map(load_named, KERNELS)}
    if unknown := [name for name in only if name not in known]:
        raise ValueError(f"no kernels {unknown}; available: {', '.join(known)}")
    return [known[name] for name in only or known]
