"""The command line: one module a verb; its docstring is the help, its `main` does the work.

`buggy-rl VERB OPTIONS` and `python scripts/NAME.py OPTIONS` run the same `main`.
"""

import re
import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout, suppress
from difflib import get_close_matches
from importlib import import_module
from io import StringIO
from pathlib import Path

PROGRAM = "buggy-rl"
VERBS = {  # subject -> verb -> module of this package, and script of that name
    "Recordings": {
        "record": "record",
        "check": "check_recordings",
        "inspect": "inspect_recordings",
        "drives": "show_drives",
        "drive": "drive",
    },
    "Simulators": {
        "fit": "fit_mujoco",
        "train": "train_models",
        "evaluate": "evaluate_models",
        "compile": "compile",
    },
    "Diagnosis": {
        "diagnose": "diagnose",
        "render": "render",
    },
    "Policies": {
        "policy": "train_policy",
        "evaluate-policies": "evaluate_policies",
        "export": "export_policy",
        "tune": "tune_drivers",
        "sweep": "sweep",
        "compare": "compare",
        "paths": "show_paths",
        "learning": "show_learning",
        "policies": "show_policies",
    },
    "All at once": {
        "demo": "demo",
        "study": "study",
        "figures": "figures",
    },
    "How good the diagnosis is": {
        "blind-demo": "blind_demo",
        "prove": "prove",
        "prove-real": "prove_real",
        "check-proof": "check_proof",
        "develop": "develop",
        "calibrate": "calibrate",
        "transfer": "transfer",
        "twins": "record_twins",
    },
}
MODULES = {verb: module for verbs in VERBS.values() for verb, module in verbs.items()}
HELP: Sequence[str] = ("-h", "--help")


def main(arguments: Sequence[str]) -> None:
    """Runs a verb with its options; without one, lists them.

    Raises:
        SystemExit: With one line where there is no such verb, or with the verb's own exit code.
    """
    verb, *options = arguments or HELP
    if verb in HELP:
        print(verbs_listing())
    elif verb == "--version":
        from buggy_rl import __version__

        print(f"{PROGRAM} {__version__}")
    elif verb not in MODULES:
        meant = "".join(f"did you mean {near!r}? " for near in get_close_matches(verb, MODULES, 1))
        raise SystemExit(f"error: no verb {verb!r}; {meant}available: {', '.join(MODULES)}")
    else:
        _called(verb, options)


def verbs_listing() -> str:
    """All verbs with what each does. Imports none of them."""
    lines = [f"{PROGRAM} VERB OPTIONS; {PROGRAM} VERB --help lists the options of a verb."]
    for subject, verbs in VERBS.items():
        lines += ["", f"{subject}:"]
        lines += [f"  {verb:18} {first_line(module)}" for verb, module in verbs.items()]
    return "\n".join(lines)


def first_line(module: str) -> str:
    """The first line of a verb's help."""
    with open(Path(__file__).with_name(f"{module}.py")) as file:
        return file.readline().strip().lstrip('r"').rstrip('"')


def in_verbs(text: str) -> str:
    """A text in which `python scripts/NAME.py` is the verb of that script."""
    verbs = {module: verb for verb, module in MODULES.items()}
    known = "|".join(verbs)
    return re.sub(
        rf"(?:python )?scripts/({known})\.py", lambda found: f"{PROGRAM} {verbs[found[1]]}", text
    )


def as_typed(text: str) -> str:
    """A text whose commands are verbs where this process was started by one, else scripts."""
    return in_verbs(text) if sys.argv[0].startswith(PROGRAM) else text


def command_line(without: str = "\n") -> str:
    """The command that this process runs, as one would type it.

    Args:
        without: Arguments that begin with this are left out.
    """
    program, *options = sys.argv
    interpreter = [] if program.startswith(PROGRAM) else ["python"]
    kept = (shlex.quote(option) for option in options if not option.startswith(without))
    return " ".join([*interpreter, program, *kept])


def _called(verb: str, options: list[str]) -> None:
    run: Callable[[], int | None] = import_module(f"{__name__}.{MODULES[verb]}").main
    sys.argv = [f"{PROGRAM} {verb}", *options]
    if not set(options) & set(HELP):
        raise SystemExit(run())
    with redirect_stdout(StringIO()) as said, suppress(SystemExit):  # after the help
        run()
    print(in_verbs(said.getvalue()), end="")
