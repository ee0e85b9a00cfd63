"""Other ways to answer the same questions, each a function of what may be seen.

A method takes the folder of a case and returns an answer in the form of `diagnosis.json` (contract
3); `verdict` and `effects` are what is counted. To add one: a file here, and its line in `METHODS`.
"""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.sealing import CaseStore
from buggy_rl.config import load_named
from buggy_rl.files import write_json

METHODS = {  # as the page calls it -> seen folder -> answer
    "random guess": "buggy_rl.blind_test.baselines.guess:guess",
    "re-tuning alone": "buggy_rl.blind_test.baselines.retune:retune",
    "mujoco.sysid": "buggy_rl.blind_test.baselines.sysid:identified",
    "sparse regression": "buggy_rl.blind_test.baselines.sindy:sindy",
    "largest cross-correlation": "buggy_rl.blind_test.baselines.correlation:correlation",
    "black-box residual": "buggy_rl.blind_test.baselines.black_box:black_box",
}
FILE = "baselines.json"


def missing(store: CaseStore, case: Case) -> list[str]:
    """Methods that have not answered a case yet."""
    answered = _answers(store.diagnosis(case.id))
    return [method for method in METHODS if method not in answered]


def compare(store: CaseStore, case: Case) -> int:
    """Lets every method answer a case that has not yet; what one gives up on is an answer too.

    Returns 1, the number of cases.
    """
    folder = store.diagnosis(case.id)
    for method in missing(store, case):
        answer: Callable[[Path], dict[str, Any]] = load_named(METHODS[method])
        begun = time.monotonic()
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
