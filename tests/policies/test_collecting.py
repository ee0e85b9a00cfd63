"""Batches from several processes: by the present policy, from every process, or an error."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.policies.training.actor_critic import Policy
from buggy_rl.policies.training.collecting import PART, CollectorConfig, PartMaker
from buggy_rl.policies.training.ppo_config import PPOConfig
from buggy_rl.policies.training.run import EngineConfig, PolicyRunConfig, new_batches
from buggy_rl.task.config import TaskConfig
from tests.jobs.counting import command_of, mine, parent

ROOT = Path(__file__).parents[2]
CARS, STEPS = 6, 8
BACKENDS = ["distributed", "rpc", "ray"]


def config(backend: str, **more) -> PolicyRunConfig:
    return PolicyRunConfig(
        output="unused",
        engine=EngineConfig("kinematic"),
        ppo=PPOConfig(cars=CARS, batch_steps=STEPS),
        collector=CollectorConfig(backend, **more),  # pyright: ignore[reportArgumentType]
    )


def observation_size() -> int:
    return maker(0)().observation_spec[keys.OBSERVATION].shape[-1]


def maker(number: int, stagger: bool = True) -> PartMaker:
    return PartMaker("kinematic", {}, {}, TaskConfig(), CARS // 2, stagger, 0, number)


def test_each_process_marks_its_environments_and_staggers_their_first_episodes_only():
    one, other = maker(0)(), maker(1)()
    ages = [env.reset()[keys.STEP_COUNT] for env in (one, other)]
    assert not torch.equal(*ages)  # each draws for itself
    assert all(age.max() > 0 for age in ages)
    assert other.rollout(2)["next", PART].unique().tolist() == [1]
    assert one.reset()[keys.STEP_COUNT].max() == 0
    assert maker(0, stagger=False)().reset()[keys.STEP_COUNT].max() == 0


def test_one_process_needs_no_other():
    assert new_batches(config("in_process"), Policy(1)) is None


@pytest.mark.parametrize("processes", [0, 4])
def test_environments_that_cannot_be_divided_are_refused(processes):
    with pytest.raises(ValueError, match=rf"processes={processes} must divide ppo.cars=6"):
        new_batches(config("rpc", processes=processes), Policy(1))


def test_a_missing_ray_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ValueError, match=r"collector.backend=ray needs the package ray.*scale"):
        new_batches(config("ray"), Policy(observation_size()))


def test_an_option_that_the_backend_does_not_take_is_an_error():
    with pytest.raises(ValueError, match=r"collector.backend=rpc did not start: .*nodes"):
        new_batches(config("rpc", options={"nodes": 3}), Policy(observation_size()))


def workers() -> list[int]:
    """Processes that step environments for this one."""
    children = [child.pid for child in multiprocessing.active_children() if child.pid]
    numbers = [int(p.name) for p in Path("/proc").iterdir() if p.name.isdigit()]
    return children + [n for n in numbers if command_of(n).startswith("ray::Collector")]


@pytest.mark.slow
@pytest.mark.parametrize("backend", BACKENDS)
def test_batches_follow_the_policy_and_a_dead_process_is_an_error(backend, monkeypatch):
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    policy = Policy(observation_size())
    batches = new_batches(config(backend), policy)
    assert batches is not None
    begun = workers()
    try:
        stream = iter(batches)
        for _ in range(3):
            with torch.no_grad():
                for weight in policy.parameters():
                    weight.add_(0.05)
            batch = next(stream)
            assert batch.batch_size == (CARS, STEPS)
            assert batch["next", PART][:, 0, 0].tolist() == [0, 0, 0, 1, 1, 1]
            expected = policy.actor()(batch.select(keys.OBSERVATION).clone())["loc"]
            torch.testing.assert_close(batch["loc"], expected)
        os.kill(begun[0], signal.SIGKILL)
        time.sleep(1.0)
        with pytest.raises(ValueError, match=rf"backend={backend}: .*all 2 processes are needed"):
            next(stream)
    finally:
        batches.close()
    time.sleep(1.0)
    assert [pid for pid in begun if command_of(pid)] == []


TRAIN = (
    "configs/ppo.yaml", "engine.simulator=kinematic", "ppo.cars=32", "ppo.steps=100_000_000",
    "ppo.batch_steps=16", "ppo.minibatch=256", "validations=1", "checkpoint_batches=1",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("blow", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("backend", BACKENDS)
def test_no_process_outlives_a_training(tmp_path, backend, blow):
    source = (
        "import runpy, signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
    )  # Ctrl-C is ignored below a shell's background
    options = [*TRAIN, f"collector.backend={backend}", f"output={tmp_path}"]
    command = [sys.executable, "-c", source, "scripts/train_policy.py", *options]
    training = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL)
    while not (tmp_path / "checkpoint.pt").exists():
        assert training.poll() is None
        time.sleep(0.1)
    numbers = [int(p.name) for p in Path("/proc").iterdir() if p.name.isdigit()]
    children = [n for n in numbers if parent(n) == training.pid]
    stepping = [n for n in children if "spawn_main" in command_of(n)]
    stepping += [n for n in numbers if command_of(n).startswith("ray::Collector")]
    assert len(stepping) == 2
    os.kill(training.pid, blow)
    assert training.wait(60) != 0
    until = time.monotonic() + 60
    while (left := [n for n in stepping if command_of(n)]) and time.monotonic() < until:
        time.sleep(0.2)
    assert left == []


@pytest.mark.slow
def test_a_training_in_several_processes_goes_on_from_its_checkpoint(tmp_path):
    def train(steps: int, *more: str) -> None:
        options = [*TRAIN, "collector.backend=rpc", f"output={tmp_path}", f"ppo.steps={steps}"]
        command = [sys.executable, "scripts/train_policy.py", *options, "ppo.schedule=constant"]
        subprocess.run([*command, *more], cwd=ROOT, check=True, stderr=subprocess.DEVNULL)

    train(1024)
    train(2048, "resume=true")
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    assert state["steps"] == 2048
    assert state["cars"] == {}
    assert mine(str(tmp_path)) == []
