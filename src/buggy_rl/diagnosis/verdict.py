"""What kind of answer it is."""

from collections.abc import Sequence

from buggy_rl.diagnosis.answer import Verdict
from buggy_rl.diagnosis.named_effect import NamedEffect
from buggy_rl.diagnosis.posterior import EVEN, Posterior


def verdict_of(posterior: Posterior, named: Sequence[NamedEffect], own: bool = False) -> Verdict:
    """The verdict by what is most probable.

    Args:
        posterior: Of what was fitted.
        named: Effects that are named, the most probable first.
        own: Whether the simulator's own parameters may be what is wrong: then effects that they
            realise are wrong parameters. Where baseline recordings show that they were right, what
            has changed since is physics.
    """
    if posterior.says != "effects":
        return "no_mismatch" if posterior.says == "nothing" else "unknown_physics"
    if not named or named[0].confidence < EVEN:
        return "cannot_tell"
    if all(n.kind == "parameter" or (own and n.inside) for n in named):
        return "wrong_parameters"
    return "missing_physics"
