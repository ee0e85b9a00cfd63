"""Whose code is run: what a file that is handed on may name, and what that must be.

A simulator file, a policy and a model are handed on from one person to another, and name code:
an engine, an effect, a transform. They may name what is in this package. They may name code of the
user's own (`path/to/file.py:Name`, `module:Name`) where it lies below the working folder, or in a
folder or module that the user trusts: `trust=PATH` on a command line, or BUGGY_RL_TRUST, several
separated as in PATH. The standard library is never taken, and of installed packages only
TorchRL's own transforms. What the user names on a command line or in a config of their own is
theirs to name.

What is named is checked to be of the class that is expected, before it is called.
"""

import importlib
import inspect
import os
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from buggy_rl.core.reads import INSTALLED, spec_of

TRUSTED = "BUGGY_RL_TRUST"  # environment variable: folders, files and modules
OPTION = "trust="
HELP = """  trust=
      Folder, .py file or module whose code files that are handed on may name, beside what lies
      below the working folder; may be given several times."""
DATA = (".yaml", ".yml", ".pt")  # names of files that are read, not run
TRANSFORMS = ("torchrl.envs", "torchrl.envs.transforms")
# Of those, the ones that neither load weights from elsewhere nor call what they are given.
OWN_TRANSFORMS = tuple(f"torchrl.envs.transforms.{m}" for m in ("_", "rb_transforms", "vecnorm"))
LOADING = {"Tokenizer"}


def taken(argv: Sequence[str]) -> list[str]:
    """A command line without `trust=PATH`, which this process and those it starts then trust.

    Raises:
        ValueError: It names nothing.
    """
    named = [argument.removeprefix(OPTION) for argument in argv if argument.startswith(OPTION)]
    if not all(named):
        raise ValueError("trust= names nothing: write trust=FOLDER, a .py file or a module")
    if named:
        known = [entry for entry in os.environ.get(TRUSTED, "").split(os.pathsep) if entry]
        absolute = [str(Path(n).resolve()) if Path(n).exists() else n for n in named]
        os.environ[TRUSTED] = os.pathsep.join([*known, *absolute])
    return [argument for argument in argv if not argument.startswith(OPTION)]


def refuse_foreign(name: str, file: Path | str) -> None:
    """Checks what a file that is handed on names, without importing it.

    Args:
        name: An engine's, effect's or transform's, from the file.
        file: That names it.

    Raises:
        ValueError: It is code of neither this package nor one that the user trusts.
    """
    place, _, attribute = name.rpartition(":")
    if not place or name.endswith(DATA):
        return
    if place.endswith(".py"):
        home = Path(place).resolve()
        if not (_is_trusted(home) or (_is_below_here(home) and not _is_installed(home))):
            raise ValueError(
                f"{file} names code that lies outside the working folder, {name}: look at it, then "
                f"say trust={home.parent} (or set {TRUSTED}), or start where it lies below"
            )
        return
    top = place.partition(".")[0]
    if top in sys.stdlib_module_names:
        raise ValueError(f"{file} names {name}, of Python's own library: such a file is not run")
    if top == "buggy_rl" or _is_trusted_module(place) or _is_own_transform(place, attribute):
        return
    if not any(_is_below_here(home) and not _is_installed(home) for home in _homes(top)):
        raise ValueError(
            f"{file} names code of another package, {name}: look at it, then say trust={top} (or "
            f"set {TRUSTED})"
        )


def refuse_other_class(found: Any, base: type, name: str) -> None:
    """Checks that what was named is a class of a kind.

    Raises:
        ValueError: It is not; the message says what it is.
    """
    if not (isinstance(found, type) and issubclass(found, base)):
        raise ValueError(
            f"{name} is {_said(found)}, expected a subclass of {base.__module__}.{base.__name__}"
        )


def refuse_other_factory(found: Any, base: type, name: str) -> None:
    """Checks that what was named is a class of a kind, or a function that may make one.

    Raises:
        ValueError: It is neither; the message says what it is.
    """
    of_python = name.partition(":")[0].partition(".")[0] in sys.stdlib_module_names
    may_make = callable(found) and not isinstance(found, type)
    if of_python or not (may_make or (isinstance(found, type) and issubclass(found, base))):
        raise ValueError(
            f"{name} is {_said(found)}, expected an {base.__name__} of {base.__module__}, or a "
            f"function factory(batch_size, device) that returns one"
        )


def _said(found: Any) -> str:
    if isinstance(found, type):
        return f"the class {found.__module__}.{found.__qualname__}"
    if inspect.isroutine(found):
        return f"the function {found.__module__}.{found.__qualname__}"
    return f"an object of class {type(found).__name__}"


def _entries() -> list[str]:
    return [entry for entry in os.environ.get(TRUSTED, "").split(os.pathsep) if entry]


def _is_trusted(home: Path) -> bool:
    return any(home.is_relative_to(Path(entry).resolve()) for entry in _entries())


def _is_trusted_module(place: str) -> bool:
    parts = place.split(".")
    modules = {".".join(parts[:count]) for count in range(1, len(parts) + 1)}
    named = any(entry in modules for entry in _entries())
    return named or any(_is_trusted(h) and not _is_installed(h) for h in _homes(parts[0]))


def _is_below_here(home: Path) -> bool:
    return home.is_relative_to(Path.cwd().resolve())


def _is_installed(home: Path) -> bool:
    library = Path(sysconfig.get_path("stdlib")).resolve()
    return bool(INSTALLED & set(home.parts)) or home.is_relative_to(library)


def _homes(top: str) -> Iterator[Path]:
    """Yields the places of a top-level module, which is not imported."""
    try:
        spec = spec_of(top)
    except (ImportError, ValueError):
        return
    for place in (spec.origin, *(spec.submodule_search_locations or ())) if spec else ():
        if place:
            yield Path(place).resolve()


def _is_own_transform(place: str, attribute: str) -> bool:
    if place not in TRANSFORMS or attribute in LOADING:
        return False
    found = getattr(importlib.import_module(place), attribute, None)
    return isinstance(found, type) and found.__module__.startswith(OWN_TRANSFORMS)
