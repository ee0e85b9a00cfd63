"""PPO's batches: from this process, or from several processes or machines; and their statistics.

In this process TorchRL's collector steps the environments. For several, `Collector(backend=...)`
starts processes that step a share of the environments each; `DistributedBatches` waits for their
batches, counts the processes that contributed, and ends all of them. Both are TorchRL's own.
"""

import contextlib
import math
import os
import queue
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase, StepCounter, Transform, TransformedEnv
from torchrl.envs.utils import ExplorationType

from buggy_rl.core import keys
from buggy_rl.jobs.launching import required
from buggy_rl.policies.training.own_actor import memory_of
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env, make_simulator

EPISODES = 100  # last finished ones, over which is averaged
PART = "collector_part"
"""Key of the number of the process that stepped an environment."""
LOOK = 0.5  # [s] between two looks at the processes while a batch is awaited
CLOSING = 20.0  # [s] for what a backend does at its end; torchrl 0.14.1 may wait for ever
STORE = 200_000_000  # [bytes] of a Ray started here; 8192 steps of 60 numbers are 2 MB
MEMORY = 1_000_000_000  # [bytes] that Ray reserves a process; benchmarks/README.md: 0.4 to 0.7 GB


@dataclass(frozen=True)
class CollectorConfig:
    """Processes in which the environments of a training are stepped."""

    backend: Literal["in_process", "ray", "distributed", "rpc"] = "in_process"
    """in_process, or TorchRL's collector of that name (docs/policies.md)."""
    processes: int = 2
    """Processes of another backend than in_process; ppo.cars are divided among them."""
    options: dict[str, Any] = field(default_factory=dict)
    """Further options of the backend's collector, such as options.launcher=submitit (distributed,
    rpc) or options.ray_init_config.address=auto."""


class ResumableCollector(Collector):
    """A collector whose run can be resumed: TorchRL's own `state_dict` leaves its state out."""

    @property
    def state(self) -> TensorDictBase:
        """State from which the next batch begins; may be replaced by that of another run."""
        return self._carrier

    @state.setter
    def state(self, state: TensorDictBase) -> None:
        self._carrier = state


def in_process(env: EnvBase, actor: nn.Module, frames: int) -> ResumableCollector:
    """Steps environments in this process, `frames` of all together a batch, without an end."""
    return ResumableCollector(
        env,
        actor,
        frames_per_batch=frames,
        total_frames=-1,
        exploration_type=ExplorationType.RANDOM,  # pyright: ignore[reportArgumentType]
        trust_policy=True,
        track_traj_ids=False,
        use_buffers=False,
        return_same_td=True,  # nothing of a batch is kept: no copy is needed
        auto_register_policy_transforms=bool(memory_of(actor)),  # `is_init`, and the state itself
    )


def longest_episode(env: EnvBase) -> int:
    """Steps after which the task ends every episode; 0 where nothing does."""
    limits = [part.max_steps for part in env.modules() if isinstance(part, StepCounter)]
    return min((limit for limit in limits if limit), default=0)


def stagger(env: EnvBase, cars: TensorDictBase, generator: torch.Generator) -> None:
    """Draws the ages of the first episodes uniformly, as after long collection."""
    if limit := longest_episode(env):
        age = cars[keys.STEP_COUNT]
        age.copy_(torch.randint(limit, age.shape, generator=generator))


class Episodes:
    """Length, reward and waypoints of the last episodes that were seen from their beginning.

    Args:
        batch_size: Of the environment.
        whole: Whether the present episodes count.
        device: Of the batches.
    """

    def __init__(
        self, batch_size: torch.Size, whole: bool, device: torch.device | None = None
    ) -> None:
        self.whole = torch.full((*batch_size, 1), whole, device=device)
        self.running = torch.zeros(*batch_size, 3, device=device)  # of the present episode
        self.last: deque[list[float]] = deque(maxlen=EPISODES)

    def take(self, batch: TensorDictBase) -> None:
        """Notes the episodes that end in a batch [cars, time]."""
        done, reward = batch["next", keys.DONE], batch["next", keys.REWARD]  # (cars, time, 1)
        closed = batch.get(("next", keys.WAYPOINTS_CLOSED), torch.full_like(reward, math.nan))
        row = torch.cat([torch.ones_like(reward), reward, closed], -1)  # (cars, time, 3)
        total = row.cumsum(-2) + self.running.unsqueeze(-2)
        ended_before, before = _at_last_end(total, done)
        counted = done & (ended_before | self.whole.unsqueeze(-2))
        self.last.extend((total - before)[counted.squeeze(-1)].tolist())
        self.whole = self.whole | done.any(-2)
        at_end = torch.where(done[..., -1, :], total[..., -1, :], before[..., -1, :])
        self.running = total[..., -1, :] - at_end

    def means(self) -> dict[str, float]:
        """`episode_length`, `episode_reward`, `waypoints`; nan before the first one."""
        names = ("episode_length", "episode_reward", "waypoints")
        values = torch.tensor(list(self.last) or [[math.nan] * len(names)]).mean(0).tolist()
        return dict(zip(names, values, strict=True))

    def state_dict(self) -> dict[str, Any]:
        """What a resumed run needs."""
        return {"whole": self.whole, "running": self.running, "last": list(self.last)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes back to where `state_dict` was taken."""
        self.whole.copy_(state["whole"])
        self.running.copy_(state["running"])
        self.last = deque(state["last"], EPISODES)


def _at_last_end(total: Tensor, done: Tensor) -> tuple[Tensor, Tensor]:
    """Whether an episode ended in this batch before a step, and `total` [*, time, 3] there."""
    step = torch.arange(done.shape[-2], device=done.device).unsqueeze(-1)
    end = torch.where(done, step, -1).cummax(-2).values
    end = torch.cat([torch.full_like(end[..., :1, :], -1), end[..., :-1, :]], -2)  # before it
    at_end = total.gather(-2, end.clamp_min(0).expand_as(total))
    return end >= 0, torch.where(end >= 0, at_end, 0.0)


class PartOfMany(Transform):
    """Writes which process an environment belongs to, and staggers its first episodes.

    Args:
        number: Of the process.
        limit: Longest age of a first episode [steps]; 0 leaves all at 0.
        seed: Of the ages.
    """

    def __init__(self, number: int, limit: int, seed: int) -> None:
        super().__init__()
        self.number, self.limit = number, limit
        self._ages = torch.Generator().manual_seed(seed)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if self.limit:
            age = tensordict_reset[keys.STEP_COUNT]
            age.copy_(torch.randint(self.limit, age.shape, generator=self._ages))
            self.limit = 0  # later episodes begin at age 0
        return self._marked(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._marked(next_tensordict)

    def _marked(self, tensordict: TensorDictBase) -> TensorDictBase:
        shape = (*tensordict.batch_size, 1)
        return tensordict.set(PART, torch.full(shape, self.number, device=tensordict.device))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Adds the number."""
        assert isinstance(observation_spec, Composite)
        shape = torch.Size([*observation_spec.shape, 1])
        observation_spec[PART] = Unbounded(shape, dtype=torch.int64, device=observation_spec.device)
        return observation_spec


@dataclass(frozen=True)
class PartMaker:
    """Makes the environments of one process there; can be pickled."""

    simulator: str
    parameters: dict
    options: dict
    task: TaskConfig
    cars: int
    """Environments of this process."""
    stagger: bool
    seed: int
    """Seed of the run; each process draws from its own."""
    number: int
    """Number of the process."""
    driver: int = field(default_factory=os.getpid)
    """Process that asked for them."""

    def __call__(self) -> EnvBase:
        """The environments, in a process with one PyTorch thread."""
        if os.getpid() != self.driver:
            threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
        torch.set_num_threads(1)
        seed = 1000 * self.seed + self.number
        torch.manual_seed(seed)
        engine = make_simulator(
            self.simulator, self.cars, parameters=self.parameters, **self.options
        )
        env = make_env(engine, task=self.task)
        limit = longest_episode(env) if self.stagger else 0
        return TransformedEnv(env, PartOfMany(self.number, limit, seed))


def _end_with(parent: int) -> None:
    """Ends this process when its parent has: an `rpc` worker waits for a killed one for ever."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def make_collector(
    config: CollectorConfig, makers: Sequence[PartMaker], actor: nn.Module, frames: int
) -> "DistributedBatches":
    """Starts the processes of a backend.

    Args:
        config: With another backend than in_process.
        makers: Of each process's environments.
        actor: The policy, whose weights are sent before every batch.
        frames: Steps of a batch, of all environments together.

    Raises:
        ValueError: The backend's package is missing, or it does not start.
    """
    options = _options(config)
    try:
        collector = Collector(
            list(makers),
            actor,
            backend=config.backend,  # pyright: ignore[reportArgumentType]  # not in_process
            sync=True,
            frames_per_batch=frames,
            total_frames=1 << 60,  # it is closed when the training ends
            exploration_type=ExplorationType.RANDOM,  # pyright: ignore[reportArgumentType]
            backend_options=options,
        )
    except (RuntimeError, TypeError, ConnectionError, TimeoutError) as error:
        raise ValueError(
            f"collector.backend={config.backend} did not start: {' '.join(str(error).split())}"
        ) from error
    return DistributedBatches(collector, config, len(makers))


class DistributedBatches:
    """Batches [cars, time] of all processes together, in the order of the processes.

    Not resumable: the environments' state stays in their processes.
    """

    state: None = None

    def __init__(self, collector: Any, config: CollectorConfig, processes: int) -> None:
        self._collector, self._config, self._processes = collector, config, processes

    def __iter__(self) -> Iterator[TensorDictBase]:
        """Batches, each by the policy as it is when the batch is asked for.

        Raises:
            ValueError: A process has ended, or its share of a batch is missing.
        """
        batches = iter(self._collector)

        def following() -> TensorDictBase:
            self._collector.update_policy_weights_()
            return next(batches)

        while True:
            yield self._whole(self._awaited(following))

    @property
    def dead(self) -> list[int]:
        """Numbers of processes that have ended; Ray tells of its own when a batch is asked for."""
        jobs = getattr(self._collector, "jobs", [])
        return [number for number, job in enumerate(jobs) if not _runs(job)]

    def close(self) -> None:
        """Ends all processes, also those that do not answer."""
        if self._config.backend == "ray":
            _within(CLOSING, lambda: self._collector.shutdown(shutdown_ray=True))
            return
        for job in self._collector.jobs:  # `shutdown` of `distributed` hung after a whole run
            job.kill() if hasattr(job, "kill") else job.cancel()
        for job in self._collector.jobs:
            if hasattr(job, "join"):
                job.join(CLOSING)
        _within(CLOSING, _leave_group)

    def _awaited(self, ask: Callable[[], TensorDictBase]) -> TensorDictBase:
        """A batch, asked for in a thread while this one watches the processes and hears Ctrl-C."""
        answers: queue.Queue[Any] = queue.Queue()
        threading.Thread(target=_answered, args=(ask, answers), daemon=True).start()
        while True:
            with contextlib.suppress(queue.Empty):
                answer = answers.get(timeout=LOOK)
                break
            if self.dead:
                raise self._lost(f"process {self.dead[0]} has ended")
        if isinstance(answer, BaseException):
            raise self._lost(" ".join(str(answer).split())[:300]) from answer
        return answer

    def _whole(self, batch: TensorDictBase) -> TensorDictBase:
        rows: Any = batch if batch.ndim == 2 else batch.flatten(0, 1)  # (cars, time)
        parts = rows["next", PART][:, 0, 0]
        counts = torch.bincount(parts, minlength=self._processes)
        if len(counts) > self._processes or len(set(counts.tolist())) > 1:
            raise self._lost(f"environments by process in a batch: {counts.tolist()}")
        return rows[parts.argsort(stable=True)]

    def _lost(self, what: str) -> ValueError:
        return ValueError(
            f"collector.backend={self._config.backend}: {what}; all {self._processes} processes "
            "are needed. Was memory short? The training goes on from its checkpoint by resume=true"
        )


def _options(config: CollectorConfig) -> dict[str, Any]:
    """What the backend's collector is given beside what all take."""
    inner = {
        "use_buffers": False,
        "track_traj_ids": False,
        "auto_register_policy_transforms": False,
        "trust_policy": True,
    }
    given = dict(config.options)
    if config.backend != "ray":
        own = {"launcher": "mp", "tcp_port": str(_free_port()), "backend": "gloo"}
        return {"collector_kwargs": inner, **own, **given}
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # before the import
    required("ray", "collector.backend=ray")
    start: dict[str, Any] = {"log_to_driver": False}
    asked = given.pop("ray_init_config", {})
    if "address" not in asked and "RAY_ADDRESS" not in os.environ:
        start |= {"num_cpus": config.processes, "object_store_memory": STORE}
        start |= {"include_dashboard": False}
    each = {"num_cpus": 1, "num_gpus": 0, "memory": MEMORY}
    options: Mapping[str, Any] = {"ray_init_config": {**start, **asked}, "remote_configs": each}
    return {"collector_kwargs": inner, **options, **given}


def _runs(job: Any) -> bool:
    return job.is_alive() if hasattr(job, "is_alive") else not job.done()


def _answered(ask: Callable[[], Any], answers: queue.Queue[Any]) -> None:
    try:
        answers.put(ask())
    except BaseException as error:  # raised where the batch is awaited
        answers.put(error)


def _within(seconds: float, work: Callable[[], Any]) -> None:
    thread = threading.Thread(target=_answered, args=(work, queue.Queue()), daemon=True)
    thread.start()
    thread.join(seconds)


def _leave_group() -> None:
    from torch.distributed import rpc

    if rpc.api._is_current_rpc_agent_set():
        rpc.shutdown(graceful=False)
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()


def _free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("localhost", 0))
        return listener.getsockname()[1]
