"""Processes beside this one, each of which rolls a share of the parameter sets out."""

import math
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, Self, TypeVar

from buggy_rl.jobs import ONE_THREAD, cores, end

ROLL_OUT, SETTING, FAILED = "roll out", "setting", "failed"
LEAST = 3000  # [environments] the reference car: 7040 take 1.2 s, 3520 0.9 s, 88 0.5 s of one core
Result = TypeVar("Result")
START = 5.0  # [s] that a start takes about
STARTING = 120.0  # [s] in which a worker must be ready: it imports PyTorch and TorchRL, 3 to 10 s


class Workers:
    """This process and `count - 1` others, which are started when they are first needed.

    A worker is given a function once, such as a simulation with its segments, and then arguments,
    one tuple a call. It has one PyTorch thread. It ends when it is closed, or when this process
    ends, however that does.

    Args:
        count: Processes, this one included; 0 for as many as there are cores for this one.
        least: Environments of which a process is worth its while; may be set later.
    """

    def __init__(self, count: int, least: int = LEAST) -> None:
        self.count = count or cores()
        self.least = least
        self._others: list[_Worker] = []
        self._closed = False

    def __reduce__(self) -> tuple[type["Workers"], tuple[int]]:
        """Pickles one process alone: in another process there is nobody else."""
        return Workers, (1,)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the other processes; from then on this one is alone."""
        self._closed = True
        others, self._others = self._others, []
        for worker in others:
            worker.end()

    def start(self) -> None:
        """Starts the other processes where they do not run yet; does not wait for them."""
        if not self._closed and not self._others:
            self._others = [_Worker(number) for number in range(1, self.count)]

    def busy(self, environments: int) -> int:
        """Processes among which so many environments are divided."""
        return 1 if self._closed else max(1, min(self.count, environments // self.least))

    def results(
        self,
        function: Callable[..., Result],
        arguments: Sequence[tuple[Any, ...]],
        seconds: float = math.inf,
    ) -> list[Result]:
        """Results of a function for each tuple of arguments, in their order.

        Args:
            function: Can be pickled; the same one is sent once.
            arguments: Dealt to the processes in turn, this one first; can be pickled.
            seconds: That one of them is expected to take; for little, no process is started.

        Raises:
            ValueError: A worker has died, or cannot do what this process can.
        """
        short = not self._others and seconds < START
        if self._closed or self.count < 2 or len(arguments) < 2 or short:
            return [function(*each) for each in arguments]
        self.start()
        setting = pickle.dumps(function)
        found: list[Result] = []
        try:
            # One question a worker at a time: two that wait to write to each other wait for ever.
            for first in range(0, len(arguments), self.count):
                own, *theirs = arguments[first : first + self.count]
                asked = list(zip(self._others, theirs, strict=False))
                for worker, each in asked:
                    worker.ask(setting, each)
                found.append(function(*own))
                found += [worker.answer(function, each) for worker, each in asked]
        except BaseException:
            self.close()  # answers that nobody has read would be taken for later ones
            raise
        return found


class _Worker:
    """The other end of one process."""

    def __init__(self, number: int) -> None:
        self.number = number
        self._setting: bytes | None = None
        self._connection, other = Pipe()
        path = os.pathsep.join(p for p in sys.path if p)
        # A session of its own: Ctrl-C reaches this process, which ends the worker.
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__, str(other.fileno())],
            pass_fds=[other.fileno()],
            start_new_session=True,
            env=os.environ | ONE_THREAD | {"PYTHONPATH": path},
        )
        other.close()
        self._started = False

    def ask(self, setting: bytes, arguments: tuple[Any, ...]) -> None:
        """Sends arguments, and the function where it is another one than before."""
        self._wait_until_ready()
        try:
            if setting != self._setting:
                self._connection.send_bytes(pickle.dumps((SETTING, setting)))
                self._setting = setting
            self._connection.send_bytes(pickle.dumps((ROLL_OUT, arguments)))
        except OSError:
            raise self._dead() from None

    def answer(self, function: Callable[..., Result], arguments: tuple[Any, ...]) -> Result:
        """The result; where the worker failed, the error as this process meets it."""
        try:
            kind, result = pickle.loads(self._connection.recv_bytes())
        except (EOFError, OSError):
            raise self._dead() from None
        if kind == FAILED:
            function(*arguments)  # a simulator's own error is raised here, where it can be read
            raise ValueError(
                f"rollouts in worker process {self._process.pid} failed with {result}, here they "
                "do not; set workers=1, and make what the simulator is built from importable"
            )
        return result

    def end(self) -> None:
        self._connection.close()
        end(self._process)

    def _wait_until_ready(self) -> None:
        if self._started:
            return
        try:
            if not self._connection.poll(STARTING):
                raise ValueError(
                    f"worker process {self._process.pid} was not ready after {STARTING:.0f} s; "
                    "set workers=1"
                )
            self._connection.recv_bytes()
        except (EOFError, OSError):
            raise self._dead() from None
        self._started = True

    def _dead(self) -> ValueError:
        code = self._process.wait()
        how = f"was ended by signal {-code}" if code < 0 else f"ended with exit code {code}"
        return ValueError(
            f"worker process {self._process.pid} {how} while it rolled the simulator out; was "
            "memory short? Set workers=1, or fewer segments by stretches="
        )


def serve(connection: Connection) -> None:
    """Answers until the other side is gone."""
    connection.send_bytes(b"ready")
    function: Callable[..., Any] | Exception = ValueError("it was given no function")
    while True:
        kind, content = pickle.loads(connection.recv_bytes())
        if kind == SETTING:
            function = _loaded(content)
            continue
        connection.send_bytes(pickle.dumps(_result(function, content)))


def _loaded(setting: bytes) -> Callable[..., Any] | Exception:
    try:
        return pickle.loads(setting)
    except Exception as error:  # told with the next result
        return error


def _result(function: Callable[..., Any] | Exception, arguments: tuple[Any, ...]) -> Any:
    if isinstance(function, Exception):
        return FAILED, f"{type(function).__name__}: {function}"
    try:
        return ROLL_OUT, function(*arguments)
    except Exception as error:
        return FAILED, f"{type(error).__name__}: {error}"


if __name__ == "__main__":
    import torch

    import_module("buggy_rl.estimation.rollout")  # needed later; imported before it is ready

    torch.set_num_threads(1)
    try:
        serve(Connection(int(sys.argv[1])))
    except (EOFError, OSError):
        sys.exit(0)  # this process's parent has ended
