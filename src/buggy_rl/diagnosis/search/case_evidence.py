"""What a joint search saw: the numbers from which probabilities are computed.

The same numbers are a line of a development ledger, so that what is calibrated is what is used.
"""

from collections.abc import Mapping
from dataclasses import asdict, astuple, dataclass
from typing import Any

from buggy_rl.core.files import rounded
from buggy_rl.diagnosis.search.candidate import Effects, Variation, leading
from buggy_rl.estimation.evidence import BaselineMisfit, Evidence

DIGITS = 5  # of every number


@dataclass(frozen=True)
class HypothesisEvidence:
    """What was seen of one fitted set of effects."""

    effects: Effects
    asked: bool
    """Whether it was fitted only because it was asked for."""
    values: Mapping[str, Mapping[str, float]]
    """Effect -> number -> fitted value in its unit; the clock's under the empty name."""
    z: tuple[float, ...]
    """[prior scales] fitted coordinates, effect by effect, the clock's last."""
    sd: tuple[float, ...]
    """[prior scales] standard deviation of each by leaving out blocks."""
    correlation: tuple[float, ...]
    """Correlation of each pair of coordinates, row by row below the diagonal; earlier ledgers have
    none."""
    at_bound: tuple[str, ...]
    """Effects with a number at a bound of its range."""
    held_out: tuple[float, ...]
    """[nats] loss of each block of segments when it was held out."""
    penalty: float
    """[nats] of the prior."""
    excess: float
    """[noise] excess misfit on what was held out."""
    typical: float
    """[noise variances] median squared standardised residual on what was held out."""
    unclosed: float
    """Share of the excess beyond the baseline's that is expected to remain."""
    channel: tuple[float, ...]
    """[6] share of each reading in the squared residual beyond the noise."""
    by_condition: tuple[float, ...]
    """Share of the variance of squared residuals that each condition explains; likewise none."""
    varies: Mapping[str, Variation]
    """Effect -> the condition with which its numbers vary most."""
    evidence: Evidence
    on_baseline: float
    """[nats] gained on a segment of the baseline, where nothing has happened yet."""
    changed: float | None = None
    """[nats] log evidence beside what simulator and car differ in anyway, less the best set's; None
    in earlier ledgers."""

    @property
    def loss(self) -> float:
        """Loss on what was held out, with the prior's penalty [nats]."""
        return sum(self.held_out) + self.penalty

    def to_dict(self) -> dict[str, Any]:
        """The hypothesis as a ledger's line has it."""
        varies = {effect: list(astuple(v)) for effect, v in self.varies.items()}
        return _as_json({**asdict(self), "varies": varies})

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "HypothesisEvidence":
        """The hypothesis of a ledger's line."""
        lists: dict[str, Any] = {
            name: tuple(content[name])
            for name in ("effects", "z", "sd", "at_bound", "held_out", "channel")
        }
        later: dict[str, Any] = {
            name: tuple(content.get(name, ())) for name in ("correlation", "by_condition")
        }
        plain = {
            name: content[name]
            for name in ("values", "penalty", "excess", "typical", "unclosed", "on_baseline")
        }
        return cls(
            **lists,
            **later,
            **plain,
            asked=content["asked"],
            varies={effect: Variation(*v) for effect, v in content["varies"].items()},
            evidence=Evidence(**content["evidence"]),
            changed=content.get("changed"),
        )


@dataclass(frozen=True)
class CaseEvidence:
    """What was seen of one comparison of a simulator with recordings."""

    first: float
    """[noise] excess misfit of the simulator as given."""
    usual: BaselineMisfit
    """Excess misfit of the simulator on its baseline."""
    segments: int
    dispersion: float
    """[noise variances] that the search came to."""
    hypotheses: tuple[HypothesisEvidence, ...]
    """Hypotheses that were fitted, the simulator as given among them; the most evident first."""

    @property
    def fitted(self) -> list[HypothesisEvidence]:
        """Hypotheses that the search came to by itself."""
        return [h for h in self.hypotheses if not h.asked]

    @property
    def leading(self) -> HypothesisEvidence:
        """The best of `fitted` by held-out loss and a price for each effect."""
        return leading(self.fitted, lambda h: h.loss)

    @property
    def null(self) -> HypothesisEvidence:
        """The simulator as given."""
        return next(h for h in self.hypotheses if not h.effects)

    def of(self, effects: Effects) -> HypothesisEvidence | None:
        """The hypothesis of a set of effects; None where it was not fitted."""
        return next((h for h in self.hypotheses if h.effects == effects), None)

    def without(self, hypothesis: HypothesisEvidence, effect: str) -> HypothesisEvidence:
        """A hypothesis without one of its effects; nothing where that was not fitted."""
        fewer = self.of(tuple(sorted({*hypothesis.effects} - {effect})))
        return self.null if fewer is None else fewer

    @property
    def rounded(self) -> "CaseEvidence":
        """Evidence with `DIGITS` digits of every number."""
        return CaseEvidence.from_dict(rounded(self.to_dict(), DIGITS))

    def to_dict(self) -> dict[str, Any]:
        """The case as a ledger's line has it."""
        return {
            "first": self.first,
            "usual": [self.usual.mean, self.usual.error],
            "segments": self.segments,
            "dispersion": self.dispersion,
            "hypotheses": [h.to_dict() for h in self.hypotheses],
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "CaseEvidence":
        """The case of a ledger's line; what else the line has is left aside."""
        return cls(
            content["first"],
            BaselineMisfit(*content["usual"]),
            content["segments"],
            content["dispersion"],
            tuple(map(HypothesisEvidence.from_dict, content["hypotheses"])),
        )


def _as_json(value: Any) -> Any:
    """Tuples as lists, however deep."""
    if isinstance(value, dict):
        return {key: _as_json(v) for key, v in value.items()}
    return [_as_json(v) for v in value] if isinstance(value, (list, tuple)) else value
