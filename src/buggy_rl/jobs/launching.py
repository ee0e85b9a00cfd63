"""Where jobs run: in processes of this machine, on a Ray cluster, or by Slurm."""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from buggy_rl.extras import needs
from buggy_rl.jobs.cores import cores
from buggy_rl.jobs.process import Command, Process

LAUNCHERS = ("local", "ray", "submitit")


@dataclass(frozen=True, kw_only=True)  # so that fields of those who inherit it come first
class Launching:
    """Where independent jobs run; their results do not depend on it."""

    launcher: Literal["local", "ray", "submitit"] = "local"
    """local, ray (a cluster of machines) or submitit (Slurm); docs/policies.md."""
    cluster: dict[str, Any] = field(default_factory=dict)
    """Options of the launcher: of ray.init, such as cluster.address=auto, or of submitit's
    executor, such as cluster.slurm_partition=long; cluster.cluster=local runs submitit here."""
    cores: int = 0
    """Cores of a job; 0 for an equal share of this machine (local), one (ray, submitit)."""
    retries: int = 5
    """Times that a job is started again after its worker was lost."""

    def share(self, workers: int) -> int:
        """Cores that each of so many jobs may keep busy."""
        return self.cores or (max(1, cores() // workers) if self.launcher == "local" else 1)


class Handle(Protocol):
    """A job that has been started somewhere."""

    def poll(self) -> str | None:
        """None while it waits or runs, then its status."""
        ...

    def end(self) -> None:
        """Ends it where it still runs, and returns when it has ended."""
        ...


class Launcher(Protocol):
    """Starts jobs."""

    def start(self, command: Command) -> Handle:
        """Starts one, at once or when a place is free."""
        ...

    def close(self) -> None:
        """Ends whatever this launcher has started beside the jobs."""
        ...


class Local:
    """Processes of this machine."""

    def start(self, command: Command) -> Process:
        """Starts one at once."""
        return Process(command)

    def close(self) -> None:
        """Nothing but the jobs was started."""


def make_launcher(launching: Launching, workers: int) -> Launcher:
    """The launcher that a config names.

    Args:
        launching: Its config.
        workers: Jobs that will run at the same time.

    Raises:
        ValueError: There is no such launcher, its package is not installed, or its options are
            not taken.
    """
    if launching.launcher not in LAUNCHERS:
        raise ValueError(f"no launcher {launching.launcher!r}; available: {', '.join(LAUNCHERS)}")
    if launching.launcher == "local":
        if launching.cluster:
            raise ValueError(
                f"cluster={dict(launching.cluster)} belongs to launcher=ray or launcher=submitit; "
                "launcher=local has no such options"
            )
        return Local()
    module = importlib.import_module(f"buggy_rl.jobs.on_{launching.launcher}")
    return module.launcher(launching.cluster, workers, launching.share(workers))


def required(package: str, what: str) -> Any:
    """Imports a package of the extra `scale`.

    Raises:
        MissingExtraError: It is not installed.
    """
    return needs(package, "scale", what)


def refuse_unknown(options: Mapping[str, Any], known: set[str], what: str) -> None:
    """Compares the names of options with those that a launcher takes.

    Raises:
        ValueError: One is not among them.
    """
    if unknown := sorted(set(options) - known):
        raise ValueError(
            f"cluster has no options {unknown} for {what}; available: {', '.join(sorted(known))}"
        )
