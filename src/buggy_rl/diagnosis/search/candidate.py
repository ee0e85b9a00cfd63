"""A fitted hypothesis, how well it predicts, and what it leaves."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

from torch import Tensor

from buggy_rl.estimation.evidence import CrossValidated, misfit, typical
from buggy_rl.estimation.gauss_newton import Fit

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
