"""Scripts run in this process, as in one of their own but without importing PyTorch anew.

What only a process of its own shows, its exit status, a signal, what `--help` imports, has tests
that start one.
"""

import io
import runpy
import signal
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import torch

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Done:
    """What a script came to."""

    returncode: int
    stdout: str
    stderr: str


def run_script(script: str, *arguments: str) -> Done:
    """Runs a script of the repository from its root, as `python SCRIPT ARGUMENTS` would.

    Args:
        script: File, from the repository's root.
        arguments: Of its command line.
    """
    out, error, code = io.StringIO(), io.StringIO(), 0
    handler, threads = signal.getsignal(signal.SIGTERM), torch.get_num_threads()
    folder = str((ROOT / script).parent)
    try:
        with (
            chdir(ROOT),
            patch.object(sys, "argv", [script, *arguments]),
            patch.object(sys, "path", [folder, *sys.path]),
            redirect_stdout(out),
            redirect_stderr(error),
        ):
            runpy.run_path(script, run_name="__main__")
    except SystemExit as ended:
        if isinstance(ended.code, str):  # as the interpreter does
            error.write(f"{ended.code}\n")
            code = 1
        else:
            code = ended.code or 0
    finally:
        signal.signal(signal.SIGTERM, handler)
        torch.set_num_threads(threads)
    return Done(code, out.getvalue(), error.getvalue())
