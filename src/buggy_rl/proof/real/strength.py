"""What is written down of how strongly the edits of a case show."""

from typing import Any

from buggy_rl.core.files import write_json
from buggy_rl.proof.baselines.asked import open_question
from buggy_rl.proof.cases.sealing import CaseStore
from buggy_rl.proof.real.case import RealCase
from buggy_rl.proof.score.oracle import true_fits, true_numbers
from buggy_rl.proof.score.strength import changed_strengths, strengths


def weigh_edited(store: CaseStore, case: RealCase, rivals: int) -> int:
    """Fits the truth of a case and writes down how strong it is; 1, the number of cases.

    Args:
        store: Where it was sealed.
        case: Nothing is fitted where the library has no effect for it.
        rivals: Other effects that are fitted.
    """
    result: dict[str, Any] = {}
    if case.family in ("one", "two"):
        try:
            ready = open_question(store.inputs(case.id)).ready
            fits = true_fits(ready.problem, true_numbers(case), rivals)
            result = strengths(fits, ready.criteria.group)
            result["changed"] = changed_strengths(fits, ready.criteria)
        except (ValueError, RuntimeError) as error:  # a drive in too many pieces
            result = {"failed": store.told(error)}
    write_json(store.oracle(case.id), result)
    return 1
