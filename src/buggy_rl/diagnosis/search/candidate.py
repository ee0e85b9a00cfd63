"""A fitted hypothesis: how well it predicts, what it leaves, whether its numbers are constant.

What the library has no equation for is closed in part by an effect that resembles it: a servo that
sticks passes for play. But the number that fits best is then another at another speed. Structural
change of regression coefficients is an old test of form (Chow 1960; Brown, Durbin, Evans 1975).
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

import torch
from torch import Tensor

from buggy_rl.diagnosis.residuals import drive_features
from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.estimation.evidence import CrossValidated, misfit, typical
from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.information import by_block
from buggy_rl.estimation.segments import Segments

Effects = tuple[str, ...]
"""Names of a hypothesis, sorted."""
PRICE = 12.0  # [nats] of an effect more, by which the leading hypothesis is chosen


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted hypothesis with its cross-validation."""

    fit: Fit
    cross_validated: CrossValidated

    @property
    def effects(self) -> Effects:
        """Effects of the hypothesis."""
        return self.fit.effects

    @property
    def key(self) -> Effects:
        """The effects, sorted."""
        return tuple(sorted(self.fit.effects))

    @property
    def held_out(self) -> Tensor:
        """Mean squared standardised residual [N] of each segment when its block was held out."""
        return self.cross_validated.square / self.fit.whitened.shape[-1]

    @property
    def typical(self) -> float:
        """Median of `held_out`."""
        return typical(self.held_out)


class OfEffects(Protocol):
    """A hypothesis, in whatever form."""

    @property
    def effects(self) -> Effects:
        """Names of its effects."""
        ...


Hypothesis = TypeVar("Hypothesis", bound=OfEffects)


def priced(hypothesis: OfEffects, loss: float) -> float:
    """A held-out loss and a price for each effect [nats]."""
    return loss + PRICE * len(hypothesis.effects)


def leading(hypotheses: Iterable[Hypothesis], loss: Callable[[Hypothesis], float]) -> Hypothesis:
    """The best hypothesis by held-out loss and a price for each effect."""
    return min(hypotheses, key=lambda h: priced(h, loss(h)))


def excess_misfit(candidate: Candidate, null: Candidate) -> float:
    """Excess misfit on what was held out, compared with the simulator as given."""
    return misfit(candidate.held_out, null.held_out) - 1


def substitutes(tried: Mapping[Effects, Candidate], others: frozenset[str]) -> dict[str, Candidate]:
    """Hypotheses of `others` and one more effect, by that one; `others` alone under ""."""
    result = {}
    for effects, candidate in tried.items():
        more = frozenset(effects) - others
        if others <= frozenset(effects) and len(more) <= 1:
            result[next(iter(more), "")] = candidate
    return result


MOST = 3.0  # [standard deviations] from the median, as which a condition counts at most
EVEN = 1e-6  # [-] of the largest value: a condition that differs by less was the same everywhere
SIGNED = ("steering", "lateral_acceleration")  # conditions whose magnitude is another one


@dataclass(frozen=True)
class Variation:
    """How much better an effect would do if its parameters were not the same in all segments."""

    condition: str = ""
    """Condition with which the parameters change most significantly."""
    closes: float = 0.0
    """Excess misfit that is closed more, on what was held out."""
    nats: float = 0.0
    """Nats by which it does better there."""


def conditions(segments: Segments, instants: Tensor) -> dict[str, Tensor]:
    """How each segment was driven: name -> [N], about its median, in standard deviations.

    Args:
        segments: N segments.
        instants: Rows [K] after the start that are read.
    """
    seen = drive_features(segments, instants)
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


def variation(
    criteria: Criteria, problem: Problem, best: Candidate, null: Candidate, effect: str
) -> Variation:
    """Lets an effect's parameters change with one condition at a time, to first order.

    theta_n = theta + u c_n with the condition c_n of a segment and u ~ N(0, variation_prior^2);
    blocks are held out one at a time, with all parameters fitted anew beside u.

    Args:
        criteria: Blocks and priors.
        problem: Of all segments; nothing is rolled out.
        best: The hypothesis, with its derivatives.
        null: The simulator as given.
        effect: One of the best's.
    """
    fit = best.fit
    assert fit.jacobian is not None
    own = [i for i, coordinate in enumerate(fit.coordinates) if coordinate.effect == effect]
    constant = held_out_square(criteria, problem, best, fit.jacobian[..., :0])
    found = Variation()
    instants = problem.simulation.instants(problem.segments)
    for name, value in conditions(problem.segments, instants).items():
        columns = fit.jacobian[..., own] * value[:, None, None]
        varied = held_out_square(criteria, problem, best, columns)
        lost = [problem.noise.loss(s, problem.dispersion) for s in (constant, varied)]
        nats = float((lost[0] - lost[1]).sum())
        if nats > found.nats:
            size = fit.whitened.shape[-1]
            first, last = (misfit(s / size, null.held_out) for s in (constant, varied))
            found = Variation(name, first - last, nats)
    return found


def held_out_square(criteria: Criteria, problem: Problem, best: Candidate, more: Tensor) -> Tensor:
    """|W e|^2 [N] of a fit with further columns, when a segment's block was held out.

    To first order, without a rollout.

    Args:
        criteria: Blocks and the columns' prior.
        problem: Of all segments.
        best: The fit, with its derivatives.
        more: [N, D, Q] changes of the whitened residuals by one prior scale.
    """
    fit, dispersion = best.fit, problem.dispersion
    assert fit.jacobian is not None
    columns = torch.cat([fit.jacobian, more], -1)
    weight = problem.noise.weight(fit.square, dispersion) / dispersion
    _, own = criteria.group.unique(return_inverse=True)
    of_blocks = by_block(columns, fit.whitened, weight, own)
    every = of_blocks.total()
    varying = torch.full((more.shape[-1],), criteria.rules.variation_prior, dtype=torch.float64)
    prior = torch.cat([fit.prior, varying])
    vector = torch.cat([fit.vector, torch.zeros_like(varying)])
    hessian, gradient = every.hessian + torch.diag(prior**-2), every.score + vector / prior**2
    steps = torch.linalg.solve(hessian - of_blocks.hessian, gradient - of_blocks.score)  # (B, P+Q)
    moved = (columns @ steps[own].unsqueeze(-1)).squeeze(-1)
    return (fit.whitened - moved).square().sum(-1)
