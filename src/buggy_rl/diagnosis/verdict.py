"""What kind of answer it is."""

from collections.abc import Sequence

from buggy_rl.diagnosis.answer import NamedEffect, Verdict
from buggy_rl.diagnosis.posterior import EVEN, Posterior


def verdict_of(posterior: Posterior, named: Sequence[NamedEffect]) -> Verdict:
    """The verdict by what is most probable; effects that are named, the most probable first."""
    if posterior.says != "effects":
        return "no_mismatch" if posterior.says == "nothing" else "unknown_physics"
    if not named or named[0].confidence < EVEN:
        return "cannot_tell"
    if all(n.kind == "parameter" for n in named):
        return "wrong_parameters"
    return "missing_physics"
