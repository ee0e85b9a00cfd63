"""Kernels: functions compiled ahead of time give what PyTorch gives."""

import shutil

import pytest
import torch

from buggy_rl.engines import make_engine
from buggy_rl.engines.single_track import KERNEL
from buggy_rl.kernels import kernel as kernel_module
from buggy_rl.kernels.kernel import FOLDER
from buggy_rl.kernels.registry import kernels

compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler here")
NAMES = [kernel.name for kernel in kernels()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kernels")
    KERNEL.compile(folder)
    return folder


def noisy(kernel, n, seed=0):
    """Arguments of n environments around the example."""
    torch.manual_seed(seed)
    return tuple(
        a if dim is None else a * (1 + 0.1 * torch.rand(a.shape)) + 0.001 * torch.rand(a.shape)
        for a, dim in zip(kernel.example(n), kernel.batch, strict=True)
    )


@pytest.mark.parametrize("name", NAMES)
def test_the_example_is_a_batch_of_which_each_row_moves_alone(name):
    (kernel,) = (k for k in kernels() if k.name == name)
    many = noisy(kernel, 4)
    few = tuple(
        a if dim is None else a.narrow(dim, 1, 2) for a, dim in zip(many, kernel.batch, strict=True)
    )
    for a, b in zip(kernel.function(*many), kernel.function(*few), strict=True):
        (dim,) = [d for d in range(a.dim()) if a.shape[d] != b.shape[d]]
        torch.testing.assert_close(a.narrow(dim, 1, 2), b)


@compiler
@pytest.mark.parametrize("n", [2, 7, 300])
def test_the_package_gives_what_pytorch_gives(folder, monkeypatch, n):
    monkeypatch.setenv(FOLDER, str(folder))
    arguments = noisy(KERNEL, n)
    with torch.no_grad():
        assert KERNEL.ready()
        for a, b in zip(KERNEL.run(*arguments), KERNEL.function(*arguments), strict=True):
            torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-6)


@compiler
def test_an_engine_drives_alike_with_it(folder, monkeypatch):
    runs = []
    for chosen in ("", str(folder)):
        monkeypatch.setenv(FOLDER, chosen)
        torch.manual_seed(0)
        env = make_engine("single_track", batch_size=3)
        with torch.no_grad():
            runs.append(env.rollout(50, break_when_any_done=False)["next", "velocity"])
    torch.testing.assert_close(*runs, rtol=1e-4, atol=1e-4)


@compiler
def test_with_derivatives_or_without_a_folder_pytorch_runs(folder, monkeypatch):
    monkeypatch.setenv(FOLDER, str(folder))
    assert not KERNEL.ready()
    with torch.no_grad():
        assert KERNEL.ready()
        monkeypatch.delenv(FOLDER)
        assert not KERNEL.ready()


@pytest.mark.parametrize("change", ["one", "double"])
def test_it_takes_batches_of_single_precision_only(change):
    arguments = KERNEL.example(1 if change == "one" else 3)
    if change == "double":
        arguments = tuple(a.double() for a in arguments)
    assert KERNEL._takes(KERNEL.example(3))
    assert not KERNEL._takes(arguments)


def test_another_source_is_another_package(monkeypatch):
    class Changed(type(KERNEL)):
        pass

    fields = {f: getattr(KERNEL, f) for f in ("name", "function", "example", "batch")}
    other = Changed(**fields, source=KERNEL.source[:-1])
    assert other.digest != KERNEL.digest
    monkeypatch.setattr(kernel_module.torch, "__version__", "0")
    assert type(KERNEL)(**fields, source=KERNEL.source).digest != KERNEL.digest
