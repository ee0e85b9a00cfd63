"""Environment steps a second of every engine, beside a one-car Gymnasium loop of the same model.

    python benchmarks/engines.py "engines=[single_track,mujoco]" "cars=[1,1024]" output=engines.json

A step is one control period (10 ms) of one car. Each combination of engine, device and threads runs
in its own process, because threads must be set before torch loads and only one environment a
process compiles well; the Gymnasium loop runs in that same process. Run it on a quiet machine.
"""

import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tqdm import tqdm

from buggy_rl.core.config import from_command_line
from buggy_rl.simulators import ENGINES

NOT_PYTORCH = ("mujoco",)  # steps on the CPU, outside of what torch compiles
HOLD_ACTION = 10  # steps: a car is given a new random action every 0.1 s
CHUNK = 10  # steps between two looks at the clock


@dataclass(frozen=True)
class Config:
    """What to measure."""

    engines: list[str] = field(default_factory=lambda: [n for n in ENGINES if n != "surrogate"])
    """Names of engines; a surrogate is its simulator's step beside the learned engine's."""
    cars: list[int] = field(default_factory=lambda: [1, 64, 1024, 4096])
    """Batch sizes."""
    threads: list[int] = field(default_factory=lambda: [1, 2])
    """Threads of torch, and of MuJoCo's batch."""
    compiled: list[int] = field(default_factory=lambda: [1024])
    """Batch sizes at which PyTorch engines are also measured compiled (up to a minute each)."""
    device: str = "auto"
    """`cpu`, `cuda`, or `auto`: the CPU, and the GPU where there is one."""
    seconds: float = 1.0
    """Length of one measurement."""
    repeats: int = 3
    """Measurements of each kind."""
    output: str = ""
    """JSON file for the figures; empty writes none."""


@dataclass(frozen=True)
class Job:
    """What one process measures."""

    engine: str
    device: str
    threads: int
    cars: list[int]
    compiled: bool
    seconds: float
    repeats: int


def main() -> None:
    """Runs the jobs one after another, prints the table and writes the JSON."""
    if sys.argv[1:2] == ["--job"]:
        work(Job(**json.loads(sys.argv[2])))
        return
    config = from_command_line(__doc__, "engines:Config")
    load = os.getloadavg()[0]
    rows = [row for job in tqdm(list(jobs(config)), unit="process") for row in run(job)]
    about = {"load_before": load, "cpus": os.cpu_count(), "config": asdict(config)}
    print(table(rows))
    if load > 0.5:
        print(f"the machine was busy when this began: load {load:.1f}")
    if config.output:
        Path(config.output).write_text(json.dumps({**about, "rows": rows}, indent=2) + "\n")


def jobs(config: Config) -> Iterator[Job]:
    """Every process to start; beside a GPU one CPU thread is enough."""
    for engine in config.engines:
        for device in devices(config.device):
            if device != "cpu" and engine in NOT_PYTORCH:
                continue
            for threads in config.threads if device == "cpu" else [1]:
                about = (engine, device, threads)
                timing = (config.seconds, config.repeats)
                yield Job(*about, sorted(config.cars), False, *timing)
                if engine not in NOT_PYTORCH:
                    yield from (Job(*about, [cars], True, *timing) for cars in config.compiled)


def devices(wish: str) -> list[str]:
    """Devices to measure on."""
    if wish != "auto":
        return [wish]
    import torch

    return ["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"]


def run(job: Job) -> list[dict[str, Any]]:
    """The rows of a job, or one row that says why there are none."""
    threads = {"OMP_NUM_THREADS": str(job.threads), "OMP_WAIT_POLICY": "PASSIVE"}
    command = [sys.executable, __file__, "--job", json.dumps(asdict(job))]
    result = subprocess.run(command, env=os.environ | threads, capture_output=True, text=True)
    marked = [line for line in result.stdout.splitlines() if line.startswith("row ")]
    rows = [json.loads(line.removeprefix("row ")) for line in marked]
    if result.returncode:
        last = (result.stderr.strip().splitlines() or ["no message"])[-1]
        rows.append({**asdict(job), "cars": job.cars[-1], "failed": last})
    return rows


def work(job: Job) -> None:
    """Measures in this process and prints one line of JSON a row."""
    import torch

    torch.set_num_threads(job.threads)
    torch.manual_seed(0)
    with torch.no_grad():
        peer = gymnasium_rate(job)
        for cars in job.cars:
            rates = batched_rates(job, cars)
            row = {
                **asdict(job),
                "cars": cars,
                "median": statistics.median(rates),
                "best": max(rates),
                "gymnasium": peer,
                "ratio": statistics.median(rates) / peer,
                "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            }
            if job.device == "cuda":
                row["gpu"] = torch.cuda.get_device_name()
                row["gpu_memory_mb"] = torch.cuda.max_memory_allocated() / 2**20
            print("row", json.dumps(row), flush=True)


def batched_rates(job: Job, cars: int) -> list[float]:
    """Steps a second of a batch of cars through TorchRL's step and partial reset."""
    import torch

    env = make(job.engine, (cars,), job.device, job.threads)
    if job.compiled:
        env.compile(warmup=3)
    actions = torch.rand(64, cars, 2, device=job.device) * 2 - 1
    state = env.reset()

    def chunk(k: int) -> None:
        nonlocal state
        for _ in range(CHUNK):
            state["action"] = actions[k * CHUNK // HOLD_ACTION % 64]
            _, state = env.step_and_maybe_reset(state)
        if job.device == "cuda":
            torch.cuda.synchronize()

    return [cars * rate for rate in rates(chunk, job)]


def gymnasium_rate(job: Job) -> float:
    """Median steps a second of the same model as one car in a plain Gymnasium environment.

    It calls the engine's physics directly on tensors, without TorchRL and without a TensorDict:
    as light as such an environment can be made. It runs on the CPU, where one car is fastest.
    """
    import gymnasium
    import numpy as np
    import torch

    class OneCar(gymnasium.Env):
        action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)

        def __init__(self) -> None:
            self.engine = make(job.engine, (), "cpu", job.threads)

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            self.state: Any = dict(self.engine.reset().items())
            return self.state["velocity"].numpy(), {}

        def step(self, action):
            action = torch.from_numpy(action).clamp(-1.0, 1.0)
            self.state = self.engine._advance(self.state, action)
            return self.state["velocity"].numpy(), 0.0, False, False, {}

    env = OneCar()
    env.reset(seed=0)
    actions = (np.random.default_rng(0).random((64, 2)) * 2 - 1).astype(np.float32)

    def chunk(k: int) -> None:
        for _ in range(CHUNK):
            env.step(actions[k * CHUNK // HOLD_ACTION % 64])

    return statistics.median(rates(chunk, job))


def rates(chunk: Callable[[int], None], job: Job) -> list[float]:
    """Steps a second over each repeat; the first chunks warm up and compile, and do not count."""
    for k in range(3):
        chunk(k)
    found = []
    for _ in range(job.repeats):
        chunks, begin = 0, time.perf_counter()
        while time.perf_counter() - begin < job.seconds:
            chunk(chunks)
            chunks += 1
        found.append(chunks * CHUNK / (time.perf_counter() - begin))
    return found


def make(name: str, batch_size: tuple[int, ...], device: str, threads: int) -> Any:
    """An engine as shipped; the learned one with the original's history MLP, untrained."""
    from buggy_rl.simulators import make_engine

    options: dict[str, Any] = {}
    if name == "mujoco":
        options["nthread"] = threads
    if name == "learned":
        options["model"] = untrained_history_mlp()
    return make_engine(name, batch_size, device, **options)


def untrained_history_mlp() -> Any:
    """History 5, two hidden layers of 64: the cost of a trained one, and a tame car."""
    import torch

    from buggy_rl.simulators.learned.factory import ModelConfig, make_model

    model = make_model(ModelConfig("mlp", options={"rows": 5}))
    model.output_scale.fill_(0.02)
    model.envelope.high.copy_(torch.tensor([3.5, 3.5, 6.5, 1.0, 1.0]))
    model.envelope.low.copy_(torch.tensor([-1.0, -3.5, -6.5, -1.0, -1.0]))
    return model


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    lines = [
        "| engine | mode | device | threads | cars | steps/s median | best "
        "| one-car Gymnasium | ratio | peak memory MB |",
        "|---|---|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        mode = "compiled" if row["compiled"] else "eager"
        start = f"| {row['engine']} | {mode} | {row['device']} | {row['threads']} | {row['cars']} "
        if "failed" in row:
            lines.append(f"{start}| failed: {row['failed']} | | | | |")
            continue
        lines.append(
            f"{start}| {row['median']:,.0f} | {row['best']:,.0f} | {row['gymnasium']:,.0f} "
            f"| {row['ratio']:,.1f} | {row['peak_memory_mb']:,.0f} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
