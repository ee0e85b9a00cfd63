"""What a search came to: every hypothesis that was fitted, under one noise model."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from buggy_rl.diagnosis.candidate import Candidate, Effects, excess_misfit, leading
from buggy_rl.diagnosis.case_evidence import CaseEvidence
from buggy_rl.diagnosis.posterior import Posterior
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.noise_model import NoiseModel


def held_out_loss(noise: NoiseModel, dispersion: float, candidate: Candidate) -> float:
    """Of a candidate on what was held out, with its prior penalty [nats]."""
    losses = noise.loss(candidate.cross_validated.square, dispersion)
    return float(losses.sum() + candidate.fit.penalty())


@dataclass(frozen=True, eq=False)
class SearchResult:
    """All hypotheses that were fitted, under one noise model and dispersion."""

    best: Candidate
    tried: Mapping[Effects, Candidate]
    noise: NoiseModel
    dispersion: float
    posterior: Posterior
    """Of the sets that were fitted, of nothing, and of what no effect describes."""
    log_evidence: Mapping[Effects, float] = field(default_factory=dict)
    """Of each hypothesis [nats]."""
    varies: Mapping[str, str] = field(default_factory=dict)
    """Effect of the best hypothesis -> condition that its numbers vary with, where they do."""
    same: Mapping[Effects, Effects] = field(default_factory=dict)
    """Sets that are another one in other words (`limits`) -> that one, which has their share."""
    observed: CaseEvidence | None = None
    """What the posterior was computed from."""
    left_out: tuple[str, ...] = ()
    """Parts of the search for which there was no time, in words."""

    @property
    def null(self) -> Candidate:
        """The simulator as given, with its clock fitted."""
        return self.tried[()]

    @property
    def predictive(self) -> Candidate:
        """The set that predicts what was held out best, at `PRICE` nats an effect."""
        return leading(self.tried.values(), self.loss)

    @property
    def described(self) -> Candidate:
        """The set whose predictions stand for the car's.

        Where no effect describes what is missing, the most probable set of effects may predict
        little: there it is the one that predicts best.
        """
        return self.predictive if self.posterior.says == "unknown" else self.best

    def problem(self, problem: Problem) -> Problem:
        """The problem with the noise model and dispersion that the search came to."""
        return replace(problem, noise=self.noise, dispersion=self.dispersion)

    def loss(self, candidate: Candidate) -> float:
        """On what was held out, with its prior penalty [nats]."""
        return held_out_loss(self.noise, self.dispersion, candidate)

    def without(self, effect: str) -> float:
        """Excess misfit without an effect, on what was held out."""
        key = tuple(sorted(set(self.best.effects) - {effect}))
        return excess_misfit(self.tried.get(key, self.null), self.null)

    def closed(self, effect: str) -> float:
        """Excess misfit that comes back without an effect; not below 0."""
        return max(0.0, self.without(effect) - excess_misfit(self.best, self.null))
