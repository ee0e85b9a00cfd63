"""Kernels: functions compiled ahead of time give what PyTorch gives."""

import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
from torchrl.envs import TransformedEnv

from buggy_rl.core import kernels as kernel
from buggy_rl.core.kernels import FOLDER, Kernel, kernels
from buggy_rl.effects import make_effect
from buggy_rl.effects.motion.base import CENTRED, MEAN_ACCELERATION, MOVED
from buggy_rl.effects.tyre.stiffness import REAR_DRIVEN as SLIPS
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.bicycle.single_track import KERNEL

compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler here")
NAMES = [k.name for k in kernels()]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return holding(tmp_path_factory.mktemp("kernels"), KERNEL)


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    """Of a step of an effect, with another slip too."""
    return holding(tmp_path_factory.mktemp("effects"), CENTRED, MEAN_ACCELERATION, MOVED, SLIPS)


def holding(folder, *of):
    """A folder with these packages: those of this source that `make install` compiled, or made."""
    for k in of:
        if k.file(kernel.CACHE).is_file():
            shutil.copy(k.file(kernel.CACHE), k.file(folder))
        else:
            k.compile(folder)
    return folder


def noisy(of, n):
    """Arguments of n environments around the example."""
    torch.manual_seed(0)
    return tuple(
        a if dim is None else a * (1 + 0.1 * torch.rand(a.shape)) + 0.001 * torch.rand(a.shape)
        for a, dim in zip(of.example(n), of.batch, strict=True)
    )


@pytest.mark.parametrize("name", NAMES)
def test_the_example_is_a_batch_of_which_each_row_moves_alone(name):
    (found,) = (k for k in kernels() if k.name == name)
    many = noisy(found, 4)
    few = tuple(
        a if dim is None else a.narrow(dim, 1, 2) for a, dim in zip(many, found.batch, strict=True)
    )
    for a, b in zip(found.function(*many), found.function(*few), strict=True):
        (dim,) = [d for d in range(a.dim()) if a.shape[d] != b.shape[d]]
        torch.testing.assert_close(a.narrow(dim, 1, 2), b)


@pytest.mark.parametrize("name", NAMES)
def test_of_a_single_car_the_results_batch_is_known(name):
    (found,) = kernels([name])
    for result, dim in zip(found.function(*noisy(found, 3)), found._batch_of_results, strict=True):
        assert result.shape[dim] == 3


@compiler
@pytest.mark.parametrize("n", [2, 7, 300])
def test_the_package_gives_what_pytorch_gives(folder, monkeypatch, n):
    monkeypatch.setenv(FOLDER, str(folder))
    arguments = noisy(KERNEL, n)
    with torch.no_grad():
        run = KERNEL.compiled(torch.ones(n))
        assert run is not None
        for a, b in zip(run(*arguments), KERNEL.function(*arguments), strict=True):
            torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-6)


@compiler
def test_a_single_car_is_run_as_one_of_a_batch(folder, monkeypatch):
    monkeypatch.setenv(FOLDER, str(folder))
    one = noisy(KERNEL, 1)
    bare = [
        a if dim is None else a.select(dim, 0) for a, dim in zip(one, KERNEL.batch, strict=True)
    ]
    with torch.no_grad():
        run = KERNEL.compiled(torch.ones(1))
        assert run is not None
        assert KERNEL.compiled(torch.ones(())) is not None
        for given in (one, bare):
            for a, b in zip(run(*given), KERNEL.function(*given), strict=True):
                torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-6)


@compiler
def test_arguments_and_results_lie_in_memory_as_the_package_has_them(folder, monkeypatch):
    monkeypatch.setenv(FOLDER, str(folder))
    with torch.no_grad():
        given = KERNEL._batch_last(noisy(KERNEL, 32))
        results = KERNEL.fastest(torch.ones(2))(*noisy(KERNEL, 32))
    assert all(a.is_contiguous() and a.shape[-1] == 32 for a in given if a.dim())
    assert all(result.movedim(0, -1).is_contiguous() for result in results)


@compiler
@pytest.mark.parametrize("n", [1, 2, 7, 17, 100, 337])
def test_no_bit_of_a_car_depends_on_how_many_are_simulated(folder, packages, monkeypatch, n):
    for folder_of, own in ((folder, KERNEL), (packages, SLIPS)):
        monkeypatch.setenv(FOLDER, str(folder_of))
        many = noisy(own, 1001)
        few = tuple(
            a if dim is None else a.narrow(dim, 3, n)
            for a, dim in zip(many, own.batch, strict=True)
        )
        with torch.no_grad():
            for way in (own.compiled(torch.ones(2)), own.function):
                batch = zip(way(*many), way(*few), own._batch_of_results, strict=True)
                for whole, part, dim in batch:
                    assert torch.equal(whole.narrow(dim, 3, n), part)


@compiler
@pytest.mark.parametrize("n", [1, 7, 32])
def test_several_runs_at_once_are_one_after_another_to_the_last_bit(folder, monkeypatch, n):
    monkeypatch.setenv(FOLDER, str(folder))
    *fixed, pose, velocity = noisy(KERNEL, n)
    with torch.no_grad():
        run = KERNEL.compiled(torch.ones(2))
        assert run is not None
        at_once = run(*fixed, pose, velocity, times=3)
        for _ in range(3):
            pose, velocity = run(*fixed, pose, velocity)
    assert all(torch.equal(a, b) for a, b in zip(at_once, (pose, velocity), strict=True))


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
def test_without_a_word_those_of_the_cache_are_used(folder, monkeypatch):
    monkeypatch.delenv(FOLDER, raising=False)
    with torch.no_grad():
        monkeypatch.setattr(kernel, "CACHE", folder)
        assert KERNEL.compiled(torch.ones(3)) is not None
        monkeypatch.setattr(kernel, "CACHE", folder / "never compiled")
        assert KERNEL.compiled(torch.ones(3)) is None


@compiler
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("payload", {"mass_ratio": 1.3}),
        ("torque_steer", {"offset": 0.01}),
        ("steering_drag", {"per_angle": 3.0}),
        ("understeer", {"gradient": 0.01}),
    ],
)
def test_an_effect_on_the_motion_acts_alike_with_it(packages, monkeypatch, name, values):
    runs = []
    for chosen in ("", str(packages)):
        monkeypatch.setenv(FOLDER, chosen)
        torch.manual_seed(0)
        effect = make_effect(name, values)
        env = TransformedEnv(make_engine("single_track", batch_size=3), effect)
        with torch.no_grad():
            after = env.rollout(50, break_when_any_done=False)["next"]
            runs.append(torch.cat([after["pose"], after["velocity"]], -1))
    torch.testing.assert_close(*runs, rtol=1e-4, atol=1e-4)


@compiler
def test_with_derivatives_or_without_a_folder_pytorch_runs(folder, monkeypatch):
    row = torch.ones(3)
    monkeypatch.setenv(FOLDER, str(folder))
    assert KERNEL.compiled(row) is None
    with torch.no_grad():
        assert KERNEL.compiled(row) is not None
        assert KERNEL.fastest(row) != KERNEL.function
        monkeypatch.setenv(FOLDER, "")
        assert KERNEL.compiled(row) is None
        assert KERNEL.fastest(row) == KERNEL.function


@compiler
@pytest.mark.parametrize("row", [torch.ones(0), torch.ones(2, 3), torch.ones(3).double()])
def test_other_batches_run_by_pytorch(folder, monkeypatch, row):
    monkeypatch.setenv(FOLDER, str(folder))
    with torch.no_grad():
        assert KERNEL.compiled(row) is None


def test_a_folder_without_the_package_is_named_with_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDER, str(tmp_path))
    with torch.no_grad(), pytest.warns(UserWarning, match="scripts/compile.py"):
        assert KERNEL.compiled(torch.ones(3)) is None


def test_of_several_missing_packages_one_is_told(tmp_path, monkeypatch, recwarn):
    monkeypatch.setenv(FOLDER, str(tmp_path))
    with torch.no_grad():
        assert not any(k.compiled(torch.ones(3)) for k in (KERNEL, CENTRED, MOVED))
    told = [str(w.message) for w in recwarn if "compile.py" in str(w.message)]
    assert len(told) == 1
    assert f"{tmp_path} holds no {KERNEL.name} of this source" in told[0]


HOLD = """
import fcntl, sys, time
with open(sys.argv[1], "a") as lock:
    fcntl.flock(lock, fcntl.LOCK_EX)
    print("held", flush=True)
    sys.stdin.read()
    if len(sys.argv) > 2:
        open(sys.argv[2], "w").close()
"""


@pytest.fixture
def compiling(tmp_path):
    """Starts a process that holds the lock of a package and, told to end, leaves one or none."""
    started = []

    def start(*made: str) -> subprocess.Popen:
        lock = KERNEL.file(tmp_path).with_suffix(".lock")
        command = [sys.executable, "-c", HOLD, str(lock), *made]
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        return process

    yield start
    for process in started:
        process.communicate()


@pytest.mark.parametrize("succeeds", [True, False])
def test_what_another_process_compiles_is_waited_for(tmp_path, compiling, capfd, succeeds):
    process = compiling(*[str(KERNEL.file(tmp_path))] * succeeds)
    with ThreadPoolExecutor() as pool:
        there = pool.submit(KERNEL.there, tmp_path)
        with pytest.raises(TimeoutError):
            there.result(timeout=0.5)
        process.communicate()
        assert there.result(timeout=60) is succeeds
    assert f"another process compiles {KERNEL.name}: waiting" in capfd.readouterr().err
    assert KERNEL.there(tmp_path) is succeeds


def test_a_package_is_not_compiled_twice(tmp_path, compiling, monkeypatch):
    monkeypatch.setattr(Kernel, "_make", lambda *_: pytest.fail("compiled a second time"))
    process = compiling(str(KERNEL.file(tmp_path)))
    with ThreadPoolExecutor() as pool:
        made = pool.submit(KERNEL.compile, tmp_path)
        with pytest.raises(TimeoutError):
            made.result(timeout=0.5)
        process.communicate()
        assert made.result(timeout=60) == KERNEL.file(tmp_path)


def test_a_lock_that_nobody_holds_makes_nobody_wait(tmp_path, capfd):
    KERNEL.file(tmp_path).with_suffix(".lock").touch()
    assert not KERNEL.there(tmp_path)
    assert "waiting" not in capfd.readouterr().err


def test_kernels_come_in_the_order_asked_for():
    asked = ["moved", "reference_substep"]
    assert [k.name for k in kernels(asked)] == asked
    with pytest.raises(ValueError, match=r"no kernels \['moves'\]; available: reference_substep, "):
        kernels(["moves"])


@pytest.mark.parametrize(
    "file", ["core/vehicle.py", "simulators/reference/tyres.py", "core/kernels.py"]
)
def test_another_source_is_another_package(tmp_path, monkeypatch, file):
    before = KERNEL.file(tmp_path)
    shutil.copytree(kernel.SOURCE, tmp_path / "copy")
    with (tmp_path / "copy" / file).open("a") as changed:
        changed.write("# another line\n")
    monkeypatch.setattr(kernel, "SOURCE", tmp_path / "copy")
    monkeypatch.setattr(kernel, "kernel_digest", kernel.kernel_digest.__wrapped__)
    assert KERNEL.file(tmp_path) != before
