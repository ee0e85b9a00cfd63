"""Terms of a repaired simulator as entries of the answer: equations that the car behaves like."""

from collections.abc import Sequence

from buggy_rl.diagnosis.answer.named_effect import NamedEffect, Value, interval
from buggy_rl.diagnosis.repair.layers import Layer
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.search.posterior import EVEN, shipped
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.effects import effect_class

ALIKE = 5  # terms that are the same over what was driven, of which so many are listed


def named_terms(
    case: DiagnosisCase, found: SearchResult, layers: Sequence[Layer]
) -> list[NamedEffect]:
    """Terms of the layer that was kept, with their numbers; none where there is no such layer.

    That the car has this very equation is not claimed: their confidence is the probability that
    the layer brings rollouts nearer, and one half at most, since it was not calibrated.

    Args:
        case: Recordings and simulator.
        found: What the search found.
        layers: Of the repaired simulator.
    """
    result = []
    for layer in layers:
        if layer.kind != "terms" or not layer.kept or layer.fitted is None:
            continue
        fit, covariance = layer.fitted.fit, layer.fitted.cross_validated.covariance
        deviation = covariance.diagonal().clamp_min(0.0).sqrt().tolist()
        form = shipped().form_error
        for c, z, sd in zip(fit.coordinates, fit.vector.tolist(), deviation, strict=True):
            if c.effect not in layer.names:
                continue
            p, kind = c.parameter, effect_class(c.effect)
            value = float(p.value_at(z))
            wide = form.sd(z, sd, 1.0)  # as where nothing of it is shown to be closed
            low, high = interval(p, z, wide)
            result.append(
                NamedEffect(
                    name=c.effect,
                    kind="term",
                    equation=kind.equation,
                    sentence=f"it behaves as if {kind.sentence({p.name: value})}",
                    parameters={p.name: Value(value, low, high, p.unit)},
                    confidence=min(EVEN, layer.probability),
                    held_out_gain=layer.nearer,
                    undetermined=(p.name,) if low < 0.0 < high else (),
                    alike=layer.alike.get(c.effect, ())[:ALIKE],
                )
            )
    return result
