"""Other ways to answer the same questions, each a function of what may be seen.

A method takes the folder of a case and returns an answer in the form of `diagnosis.json` (contract
3); `verdict` and `effects` are what is counted. To add one: a file here, and its line in `METHODS`.
"""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from buggy_rl.core.config import load_named
from buggy_rl.core.files import write_json
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import CaseStore

METHODS = {  # as the page calls it -> seen folder -> answer
    "random guess": "buggy_rl.proof.baselines.asked:guess",
    "re-tuning alone": "buggy_rl.proof.baselines.retune:retune",
    "mujoco.sysid": "buggy_rl.proof.baselines.sysid:identified",
    "sparse regression": "buggy_rl.proof.baselines.sindy:sindy",
    "largest cross-correlation": "buggy_rl.proof.baselines.columns:correlation",
    "black-box residual": "buggy_rl.proof.baselines.retune:black_box",
}
FILE = "baselines.json"


def unanswered_methods(store: CaseStore, case: Case) -> list[str]:
    """Methods that have not answered a case yet."""
    answered = _answers(store.diagnosis(case.id))
    return [method for method in METHODS if method not in answered]


def compare(store: CaseStore, case: Case) -> int:
    """Lets every method answer a case that has not yet; what one gives up on is an answer too.

    Returns 1, the number of cases.
    """
    folder = store.diagnosis(case.id)
    for method in unanswered_methods(store, case):
        answer: Callable[[Path], dict[str, Any]] = load_named(METHODS[method])
        begun = time.monotonic()
        said: dict[str, Any]
        try:
            said = answer(store.inputs(case.id))
        except (ValueError, ArithmeticError, RuntimeError) as error:
            said = {"verdict": "crashed", "effects": [], "notes": [str(error)]}
        said["seconds"] = time.monotonic() - begun
        write_json(folder / FILE, {**_answers(folder), method: said})
    return 1


def _answers(folder: Path) -> dict[str, Any]:
    file = folder / FILE
    return json.loads(file.read_text()) if file.exists() else {}
