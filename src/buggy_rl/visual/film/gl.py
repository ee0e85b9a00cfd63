"""Which OpenGL of MuJoCo works here: tried in processes of its own, once for this process."""

import os
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from threading import Timer
from typing import Any

from buggy_rl.visual.film import worker

PATIENCE = 60.0  # [s] for a start or a frame; a start takes 3 s alone and 15 s on a busy machine
REMEDY = "install libegl1 and libgl1 (apt-get install -y libegl1 libgl1)"


class WorkerError(RuntimeError):
    """The process that renders failed; the message says how."""


class WorkerProcess:
    """A `worker` under one backend; ends with `close` or the garbage collector.

    Args:
        backend: Value of `MUJOCO_GL`; empty for MuJoCo's own choice.
    """

    def __init__(self, backend: str) -> None:
        self.backend = backend
        environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
        if backend:
            environment["MUJOCO_GL"] = backend
        self._process = subprocess.Popen(
            [sys.executable, "-P", worker.__file__],  # -P: our folder is no place to import from
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._requests, self._answers = self._process.stdin, self._process.stdout

    def ask(self, content: Any) -> Any:
        """Sends a request and waits for its answer.

        Raises:
            WorkerError: The process failed, ended, or took longer than `PATIENCE`.
        """
        self.send(content)
        return self.receive()

    def send(self, content: Any) -> None:
        """Sends a request.

        Raises:
            WorkerError: The process has ended.
        """
        try:
            worker.send(self._requests, content)
        except OSError as error:
            raise WorkerError(f"{self._named} has ended: {error}") from error

    def receive(self) -> Any:
        """Waits for the answer to the earliest request that has none.

        Raises:
            WorkerError: The process failed, ended, or took longer than `PATIENCE`.
        """
        limit = Timer(PATIENCE, self._process.kill)
        limit.daemon = True
        limit.start()
        try:
            answer = worker.receive(self._answers)
        except EOFError:
            how = "crashed" if limit.is_alive() else f"did not answer within {PATIENCE:g} s"
            raise WorkerError(f"{self._named} {how}") from None
        finally:
            limit.cancel()
        if isinstance(answer, str):
            raise WorkerError(f"{self._named}: {answer}")
        return answer

    def close(self) -> None:
        """Ends the process."""
        for stream in (self._requests, self._answers):
            with suppress(OSError):  # it ended before it read the last request
                stream.close()
        self._process.kill()
        self._process.wait()

    @property
    def _named(self) -> str:
        return f"MUJOCO_GL={self.backend}" if self.backend else "MuJoCo's default OpenGL"


@dataclass(frozen=True)
class Probe:
    """Result of looking for an OpenGL that works."""

    backend: str | None
    """Value of `MUJOCO_GL` that works; None if none does."""
    reason: str
    """Why none does, a clause for each that was tried."""


def gl_backends(environment: dict[str, str], platform: str = sys.platform) -> list[str]:
    """Values of `MUJOCO_GL` to try, in order; one that is set is the only one."""
    if environment.get("MUJOCO_GL"):
        return [environment["MUJOCO_GL"]]
    if not platform.startswith("linux"):
        return [""]
    return ["egl", "osmesa", *(["glfw"] if environment.get("DISPLAY") else [])]


@cache
def probe() -> Probe:
    """Draws an empty scene in a new process under each candidate until one works."""
    failures = []
    for backend in gl_backends(dict(os.environ)):
        process = WorkerProcess(backend)
        try:
            process.ask(None)
            return Probe(backend, "")
        except WorkerError as error:
            failures.append(str(error))
        finally:
            process.close()
    return Probe(None, "; ".join(failures))
