"""PPO's batches from several processes or machines, through TorchRL's own distributed collectors.

`Collector(backend=...)` starts processes that step a share of the environments each; this module
waits for their batches, counts the processes that contributed, and ends all of them.
"""

import contextlib
import os
import queue
import socket
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs.utils import ExplorationType

from buggy_rl.jobs.launching import required
from buggy_rl.policies.worker_part import PART, PartMaker

LOOK = 0.5  # [s] between two looks at the processes while a batch is awaited
CLOSING = 20.0  # [s] for what a backend does at its end; torchrl 0.14.1 may wait for ever
STORE = 200_000_000  # [bytes] of a Ray started here; 8192 steps of 60 numbers are 2 MB
MEMORY = 1_000_000_000  # [bytes] that Ray reserves a process; benchmarks/README.md: 0.4 to 0.7 GB


@dataclass(frozen=True)
class CollectorConfig:
    """Where the environments of a training are stepped."""

    backend: Literal["in_process", "ray", "distributed", "rpc"] = "in_process"
    """in_process, or TorchRL's collector of that name (docs/policies.md)."""
    processes: int = 2
    """Of another backend than in_process; ppo.cars are divided among them."""
    options: dict[str, Any] = field(default_factory=dict)
    """Further options of the backend's collector, such as options.launcher=submitit (distributed,
    rpc) or options.ray_init_config.address=auto."""


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

    state = None

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
