"""Is the number of a named cause one number? That of a lookalike changes with how one drives.

What the library has no equation for is closed in part by one that resembles it: a servo that sticks
passes for play, a car that steers by leaning for a steering gain. But the number that fits best is
then another at another speed. Structural change of a regression's
coefficients is an old test of its form (Chow 1960; Brown, Durbin, Evans 1975).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.localisation import features
from buggy_rl.estimation.gauss_newton import Fitter
from buggy_rl.estimation.misfit import misfit
from buggy_rl.estimation.segments import Stretches

MOST = 3.0  # standard deviations from the median, as which a stretch's condition counts at most
VARIATION = 1.0  # sd of how a number may vary with a condition's sd, in units of its size
EVEN = 1e-6  # of the largest value: what differs by less was the same in all stretches
SIGNED = ("steering", "lateral_acceleration")  # conditions of which the amount is another one
WORDS = {
    "vx": "speed",
    "acceleration": "speeding up and slowing down",
    "throttle": "throttle",
    "steering": "the side that is steered to",
    "abs_steering": "how far is steered",
    "steering_rate": "how fast the steering moves",
    "lateral_acceleration": "the side that is leant to",
    "abs_lateral_acceleration": "sideways acceleration",
    "heading_x": "heading",
    "heading_y": "heading",
    "elapsed": "time since the start",
    "x": "place",
    "y": "place",
}


@dataclass(frozen=True)
class Varying:
    """How much better a cause would do if its numbers were not the same in all stretches."""

    condition: str = ""
    """With what they change most tellingly."""
    closes: float = 0.0
    """Excess over the noise that is closed more, on what was held out."""
    nats: float = 0.0
    """By which it does better there."""


def conditions(cut: Stretches, instants: Tensor) -> dict[str, Tensor]:
    """How each stretch was driven: name -> [N], about its median, in standard deviations.

    Args:
        cut: N stretches.
        instants: Rows [K] after the start that are read.
    """
    seen = features(cut, instants)
    heading = seen.pop("heading")
    seen |= {"heading_x": torch.cos(heading), "heading_y": torch.sin(heading)}
    seen |= {f"abs_{name}": seen[name].abs() for name in SIGNED}
    seen["steering_rate"] = seen["steering_rate"].abs()
    means = {name: value.double().mean(1) for name, value in seen.items()}
    means["acceleration"] = (seen["vx"][:, -1] - seen["vx"][:, 0]).double()
    return {
        name: ((x - x.median()) / x.std()).clamp(-MOST, MOST)
        for name, x in means.items()
        if float(x.std()) > EVEN * float(x.abs().max())
    }


def varying(fitter: Fitter, best: Candidate, null: Candidate, group: Tensor, cause: str) -> Varying:
    """Lets a cause's numbers change with one condition at a time, to first order.

    Blocks are held out one at a time, with all numbers fitted anew beside the change.

    Args:
        fitter: To all stretches; not asked to roll out anything.
        best: The explanation, with its slopes.
        null: The simulator as given.
        group: [N] blocks that are held out together.
        cause: One of the best's.
    """
    fitted = best.fitted
    assert fitted.slopes is not None
    own = [i for i, unknown in enumerate(fitted.unknowns) if unknown.cause == cause]
    none = fitted.slopes[..., :0]
    loss, same = fitter.likelihood.loss, _held_out(fitter, best, group, none)
    found = Varying()
    for name, value in conditions(fitter.cut, fitter.player.instants(fitter.cut)).items():
        other = _held_out(fitter, best, group, fitted.slopes[..., own] * value[:, None, None])
        nats = float((loss(same, fitter.temper) - loss(other, fitter.temper)).sum())
        if nats > found.nats:
            readings = fitted.white.shape[-1]
            first, last = (misfit(s / readings, null.held_out) for s in (same, other))
            found = Varying(name, first - last, nats)
    return found


def _held_out(fitter: Fitter, best: Candidate, group: Tensor, more: Tensor) -> Tensor:
    """[N] |W e|^2 with further columns [N, D, Q], when a stretch's block was held out."""
    fitted = best.fitted
    assert fitted.slopes is not None
    columns = torch.cat([fitted.slopes, more], -1)
    weight = fitter.likelihood.weight(fitted.square, fitter.temper) / fitter.temper
    curve = torch.einsum("ndp,ndq,n->npq", columns, columns, weight)
    score = torch.einsum("ndp,nd,n->np", columns, fitted.white, weight)
    wide = [u.prior for u in fitted.unknowns] + [VARIATION] * more.shape[-1]
    prior = torch.tensor(wide, dtype=torch.float64)
    place = torch.cat([fitted.place, torch.zeros(more.shape[-1], dtype=torch.float64)])
    hessian, gradient = curve.sum(0) + torch.diag(prior**-2), score.sum(0) + place / prior**2
    square = torch.empty(len(group), dtype=torch.float64)
    for block in group.unique():
        out = group == block
        step = torch.linalg.solve(hessian - curve[out].sum(0), gradient - score[out].sum(0))
        square[out] = (fitted.white[out] - columns[out] @ step).square().sum(-1)
    return square
