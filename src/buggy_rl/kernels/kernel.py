"""A function of tensors, run from its compiled package where there is one and else by PyTorch.

Of a few hundred cars an operation of PyTorch takes microseconds whatever it does, and a step of a
car has hundreds. Compiled into one call they take as long as their arithmetic. Both give the same
numbers to rounding, but not to the last bit. Compiling takes up to a minute a function and a C++
compiler, so it is done once, by `scripts/compile.py`, and only who names the folder of the packages
gets them. A package holds for the source that it was made of and no other.

Source: `torch.export` and `torch._inductor.aoti_compile_and_package`, PyTorch documentation.
"""

import hashlib
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path

import torch
from torch import Tensor

FOLDER = "BUGGY_RL_KERNELS"
"""Environment variable: the folder of the packages; none are used where it is not set."""
LARGEST = 1_000_000  # environments in one call


@dataclass(frozen=True, eq=False)
class Kernel:
    """A pure function of float32 tensors whose batch is one dimension of at least two."""

    name: str
    function: Callable[..., tuple[Tensor, ...]]
    example: Callable[[int], tuple[Tensor, ...]]
    """Arguments for a batch of n."""
    batch: tuple[int | None, ...]
    """Of each argument, the dimension of the batch; None where it has none."""
    source: tuple[str, ...]
    """Modules that the result follows from: a change of one makes the package void."""

    def __call__(self, *arguments: Tensor) -> Sequence[Tensor]:
        if self.ready() and self._takes(arguments):
            return self.run(*arguments)
        return self.function(*arguments)

    def ready(self) -> bool:
        """Whether its package is there, and no derivatives are asked for."""
        return (
            not torch.is_grad_enabled() and _package(self, os.environ.get(FOLDER, "")) is not None
        )

    def run(self, *arguments: Tensor) -> Sequence[Tensor]:
        """Runs the package, which must be `ready`, on arguments like those of `example`."""
        run = _package(self, os.environ.get(FOLDER, ""))
        assert run is not None
        return run([argument.contiguous() for argument in arguments])

    def _takes(self, arguments: Sequence[Tensor]) -> bool:
        """Whether these are on the CPU, of single precision, in one batch of at least two."""
        return all(
            a.dtype == torch.float32
            and a.device.type == "cpu"
            and a.dim() == rank
            and (dim is None or a.shape[dim] > 1)
            for a, rank, dim in zip(arguments, self._ranks, self.batch, strict=True)
        )

    @cached_property
    def _ranks(self) -> list[int]:
        return [argument.dim() for argument in self.example(2)]

    @cached_property
    def digest(self) -> str:
        """Of the source, PyTorch and the processor."""
        parts = [torch.__version__, platform.machine(), torch.backends.cpu.get_cpu_capability()]
        for module in self.source:
            file = import_module(module).__file__
            assert file is not None
            parts.append(Path(file).read_text(encoding="utf-8"))
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]

    def file(self, folder: Path) -> Path:
        """Its package."""
        return folder / f"{self.name}-{self.digest}.pt2"

    def compile(self, folder: Path) -> Path:
        """Makes the package.

        Raises:
            RuntimeError: There is no C++ compiler, or it refuses.
        """
        import torch._inductor.config as inductor

        arguments = self.example(64)
        cars = torch.export.Dim("cars", min=2, max=LARGEST)
        shapes = tuple(None if dim is None else {dim: cars} for dim in self.batch)
        folder.mkdir(parents=True, exist_ok=True)
        written = self.file(folder).with_suffix(f".{os.getpid()}.pt2")
        # One thread: cases run beside each other, and sums keep their order.
        with torch.no_grad(), inductor.patch({"cpp.threads": 1}):
            program = torch.export.export(
                _Module(self.function), arguments, dynamic_shapes=(shapes,)
            )
            torch._inductor.aoti_compile_and_package(program, package_path=str(written))
        os.replace(written, self.file(folder))
        return self.file(folder)


class _Module(torch.nn.Module):
    """A function as `torch.export` takes it."""

    def __init__(self, function: Callable[..., tuple[Tensor, ...]]) -> None:
        super().__init__()
        self.function = function

    def forward(self, *arguments: Tensor) -> tuple[Tensor, ...]:
        return self.function(*arguments)


@cache
def _package(kernel: Kernel, folder: str) -> Callable[[list[Tensor]], list[Tensor]] | None:
    if not folder or not kernel.file(Path(folder)).is_file():
        return None
    # Without what nests arguments and results, which are flat lists: a third of the time.
    file = str(kernel.file(Path(folder)))
    return torch._inductor.aoti_load_package(file, run_single_threaded=True).loader.run
