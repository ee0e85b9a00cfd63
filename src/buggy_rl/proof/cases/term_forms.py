"""Which terms of the grammar have the form of a composed sort: place, signal, shape and memory."""

from functools import cache

from buggy_rl.effects.terms.grammar import Term, terms
from buggy_rl.proof.plants.composed import UNNAMED, Sort

PLACES = {  # where a sort acts -> place of a term
    **{name: name for name in ("forward", "side", "yaw", "throttle", "steering")},
    "seen_yaw": "shown_heading",
    "seen_speed": "shown_vx",
    "seen_drift": "shown_vy",
    "seen_yaw_rate": "shown_yaw_rate",
}
SIGNALS = {"lateral": "lateral_acceleration"}
SHAPES = {  # shape of a sort -> those of terms that have its form
    "linear": ("linear",),
    "even": ("even",),
    "square": ("odd_square", "even_square"),
    "saturating": ("saturating",),
    "threshold": ("threshold",),
}


def has_form(term: Term, sort: Sort) -> bool:
    """Whether a term has place, signal, shape and memory of a sort."""
    return (
        term.place == PLACES[sort.where]
        and term.signals == (SIGNALS.get(sort.of, sort.of),)
        and term.shape in SHAPES[sort.shape]
        and term.memory == sort.memory
    )


@cache
def sorts_with_terms() -> tuple[str, ...]:
    """Sorts without a name in the library of which some term has the form."""
    every = terms()
    return tuple(n for n in UNNAMED if any(has_form(t, Sort.named(n)) for t in every))
