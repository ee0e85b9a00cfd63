"""Other ways to answer the same questions, each a function of what may be seen.

A method takes the folder of a case and returns an answer in the form of `diagnosis.json` (contract
3); `verdict` and `effects` are what is counted. To add one: a file here, and its entry in
`METHODS`, which also says what it can name.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from buggy_rl.core.config import load_named
from buggy_rl.core.files import write_json
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import CaseStore

HERE = "buggy_rl.proof.baselines"


@dataclass(frozen=True)
class Method:
    """Another way to answer, and what it can say."""

    answer: str
    """Function: folder of what may be seen -> answer."""
    names: str
    """Function of `nameable`: case -> effects that it can name there; None where it has no answer
    at all."""
    most: int = 1
    """Effects that it can name at once."""
    unknown: bool = False
    """Whether it can say that something is missing that no effect describes."""

    def represents(self, case: Case) -> bool:
        """Whether the right answer to a case is one that it can give."""
        if case.unknown:
            return self.unknown
        able: frozenset[str] | None = load_named(f"{HERE}.nameable:{self.names}")(case)
        return able is not None and len(case.truth) <= self.most and {*case.truth} <= able


METHODS = {  # as the page calls it
    "random guess": Method(f"{HERE}.asked:guess", "library"),
    "largest cross-correlation": Method(f"{HERE}.columns:correlation", "library"),
    "sparse regression with delays": Method(f"{HERE}.sindy:sindy", "library"),
    "fit each, by BIC": Method(f"{HERE}.each:by_bic", "library"),
    "fit each, by held-out density": Method(f"{HERE}.each:by_held_out_density", "library"),
    "greedy selection": Method(f"{HERE}.greedy:greedy", "library", most=3),
    "re-tuning alone": Method(f"{HERE}.retune:retune", "parameters"),
    "mujoco.sysid": Method(f"{HERE}.sysid:identified", "inside_mujoco"),
    "black-box residual": Method(f"{HERE}.retune:black_box", "nothing", most=0, unknown=True),
}
FILE = "baselines.json"
CRASHED = "crashed"  # verdict of a method that gave no answer


def unanswered_methods(store: CaseStore, case: Case) -> list[str]:
    """Methods that have not answered a case yet."""
    answered = _answers(store.diagnosis(case.id))
    return [method for method in METHODS if method not in answered]


def compare(store: CaseStore, case: Case) -> int:
    """Lets every method answer a case that has not yet; a crash is kept as one.

    Returns 1, the number of cases.
    """
    folder = store.diagnosis(case.id)
    for method in unanswered_methods(store, case):
        answer: Callable[[Path], dict[str, Any]] = load_named(METHODS[method].answer)
        begun = time.monotonic()
        said: dict[str, Any]
        try:
            said = answer(store.inputs(case.id))
        except (ValueError, ArithmeticError, RuntimeError) as error:
            said = {"verdict": CRASHED, "effects": [], "notes": [str(error)]}
        said["seconds"] = time.monotonic() - begun
        write_json(folder / FILE, {**_answers(folder), method: said})
    return 1


def _answers(folder: Path) -> dict[str, Any]:
    file = folder / FILE
    return json.loads(file.read_text()) if file.exists() else {}
