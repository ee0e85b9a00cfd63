"""What kind of answer it is."""

from collections.abc import Sequence

from buggy_rl.diagnosis.answer import Named, Verdict
from buggy_rl.diagnosis.confidence import SOUND
from buggy_rl.diagnosis.unexplained import Remaining
from buggy_rl.estimation.misfit import Usual

UNDECIDED = 0.5  # confidence below which an answer is no answer,
RIVALLED = 0.1  # and probability of its rivals above which it is not the only one


def verdict_of(given: float, rest: Remaining, named: Sequence[Named], usual: Usual) -> Verdict:
    """The verdict.

    Args:
        given: Excess of the simulator as given over the noise.
        rest: What no cause closes.
        named: Causes, the weightiest first.
        usual: Excess of drives on which the simulator counts as right.
    """
    if given < usual.most and not named:
        return "no_mismatch"
    unsure = max((n.confidence for n in named), default=0.0) < UNDECIDED
    # Much may remain beside a name that is sound: where a car spins, nobody foretells it all. Nor
    # is physics unknown because two names that are both known share what is likely.
    doubtful = max((n.sound for n in named), default=0.0) < UNDECIDED
    if not named or (doubtful and rest.share > SOUND):
        return "unknown_physics" if rest.excess > usual.most else "no_mismatch"
    if all(n.varies_with for n in named):
        return "unknown_physics"  # whatever it is, these names only resemble it
    if unsure or sum(named[0].confused_with.values()) > RIVALLED:
        return "cannot_tell"
    if all(n.kind == "parameter" for n in named):
        return "wrong_parameters"
    return "missing_physics"
