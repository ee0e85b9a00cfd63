"""What kind of answer it is."""

from collections.abc import Sequence

from buggy_rl.diagnosis.answer import NamedEffect, Verdict
from buggy_rl.diagnosis.posterior import EVEN, Posterior
from buggy_rl.diagnosis.selection import Criteria
from buggy_rl.diagnosis.unexplained import Unexplained


def verdict_of(
    given: float, rest: Unexplained, named: Sequence[NamedEffect], criteria: Criteria
) -> Verdict:
    """The verdict.

    Args:
        given: Excess misfit of the simulator as given.
        rest: What no effect closes.
        named: Effects, that with the largest gain first.
        criteria: Thresholds and the excess that is usual on the baseline.
    """
    rules, usual = criteria.rules, criteria.usual
    if given < usual.most and not named:
        return "no_mismatch"
    unsure = max((n.confidence for n in named), default=0.0) < rules.undecided
    # Much may remain beside a name that is sound: where a car spins, no simulator predicts it all.
    # Nor is physics unknown because two names that are both known share what is likely.
    doubtful = max((n.sound for n in named), default=0.0) < rules.undecided
    if not named or (doubtful and rest.share > rules.unknown_share):
        return "unknown_physics" if rest.excess > usual.most else "no_mismatch"
    if all(n.varies_with for n in named):
        return "unknown_physics"  # whatever it is, these names only resemble it
    if unsure or sum(named[0].confused_with.values()) > rules.rivalled:
        return "cannot_tell"
    if all(n.kind == "parameter" for n in named):
        return "wrong_parameters"
    return "missing_physics"


def verdict_by(posterior: Posterior, named: Sequence[NamedEffect]) -> Verdict:
    """The verdict by what is most probable; effects that are named, the most probable first."""
    if posterior.says != "effects":
        return "no_mismatch" if posterior.says == "nothing" else "unknown_physics"
    if not named or named[0].confidence < EVEN:
        return "cannot_tell"
    if all(n.kind == "parameter" for n in named):
        return "wrong_parameters"
    return "missing_physics"
