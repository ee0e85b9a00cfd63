"""Jobs as remote functions of Ray: on its cluster, or on one that is started here and ended again.

A worker of Ray watches the job's process (`process.attend`); no data but its command goes through
Ray. Folders are reached by the same paths on all machines.
"""

import contextlib
import inspect
import logging
import os
import signal
import socket
from collections.abc import Iterator, Mapping
from typing import Any

from buggy_rl.jobs.launching import refuse_unknown_options, required
from buggy_rl.jobs.process import GRACE, LOST, STOP, STOPPED, Command, attend

PATIENCE = 5.0  # [s] for a cluster to take a connection; on loopback it takes under 1 ms
STORE = 200_000_000  # [bytes] object store of a cluster started here; commands take some 600 bytes


def launcher(options: Mapping[str, Any], workers: int, cores: int) -> "OnRay":
    """Connects to the cluster, or starts one of `workers` times `cores` on this machine.

    The cluster is `options["address"]`, else that of RAY_ADDRESS, as for `ray.init`.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # before the import
    return OnRay(required("ray", "launcher=ray"), dict(options), workers * cores, cores)


class OnRay:
    """Starts jobs on a cluster.

    Raises:
        ValueError: `ray.init` does not take the options, or there is no cluster at the address.
    """

    def __init__(self, ray: Any, options: dict[str, Any], total: int, cores: int) -> None:
        known = {n for n in inspect.signature(ray.init).parameters if n != "kwargs"}
        refuse_unknown_options(options, known, "launcher=ray")
        self._ray = ray
        address = options.pop("address", None) or os.environ.get("RAY_ADDRESS", "local")
        if address == "local":
            options = {"num_cpus": total, "object_store_memory": STORE, **options}
            options.setdefault("include_dashboard", False)
            options.setdefault("logging_level", logging.ERROR)
        with _handlers_kept():
            try:
                _reached(address)
                ray.init(address, **{"log_to_driver": False, **options})
            except (OSError, ValueError, TypeError) as error:
                raise ValueError(
                    f"no Ray cluster at {address}: {' '.join(str(error).split())}; start one by "
                    "`ray start --head`, or leave cluster.address and RAY_ADDRESS out"
                ) from None
        # Ray's own retries are off: it would repeat a job killed for memory for ever, and losses
        # of the job's process, which Ray does not see, are counted together with these.
        self._attend = ray.remote(num_cpus=cores, max_retries=0)(attend)

    def start(self, command: Command) -> "RayHandle":
        """Starts one when the cluster has the cores."""
        (command.folder / STOP).unlink(missing_ok=True)
        return RayHandle(self._ray, self._attend.remote(command), command)

    def close(self) -> None:
        """Disconnects; ends the cluster if it was started here."""
        with _handlers_kept():
            self._ray.shutdown()


class RayHandle:
    """A job on the cluster."""

    def __init__(self, ray: Any, reference: Any, command: Command) -> None:
        self._ray, self._reference, self._command = ray, reference, command

    def poll(self) -> str | None:
        """None while it waits or runs; `lost` where its worker or machine was."""
        return self._status(0.0)

    def end(self) -> None:
        """Tells the worker to end it, and kills the worker that does not."""
        (self._command.folder / STOP).touch()
        self._ray.cancel(self._reference, force=False)  # of one that still waits
        if self._status(2 * GRACE) is None:
            self._ray.cancel(self._reference, force=True)

    def _status(self, patience: float) -> str | None:
        ready, _ = self._ray.wait([self._reference], timeout=patience)
        if not ready:
            return None
        try:
            return self._ray.get(self._reference)
        except self._ray.exceptions.TaskCancelledError:
            return STOPPED
        except self._ray.exceptions.RayTaskError as error:
            raise ValueError(f"{self._command.folder}: its worker failed: {error}") from None
        except self._ray.exceptions.RayError:
            return LOST


def _reached(address: str) -> None:
    """Knocks at HOST:PORT: `ray.init` itself takes minutes to find that nobody is there."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdecimal():
        socket.create_connection((host, int(port)), PATIENCE).close()


@contextlib.contextmanager
def _handlers_kept() -> Iterator[None]:
    """Ray replaces the handler of SIGTERM, by which a script ends what it has started."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
