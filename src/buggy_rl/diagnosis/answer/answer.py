"""The answer of a diagnosis: `diagnosis.json` for programs, and a few sentences for a person."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from buggy_rl.diagnosis.answer.behaviour import Behaviour, FormFault, differing
from buggy_rl.diagnosis.answer.equivalents import Equivalents
from buggy_rl.diagnosis.answer.experiments import DecisionRate
from buggy_rl.diagnosis.answer.located import Located
from buggy_rl.diagnosis.answer.named_effect import SUREST, NamedEffect
from buggy_rl.diagnosis.answer.other_sensors import SensorFinding
from buggy_rl.diagnosis.repair.layers import Layer
from buggy_rl.diagnosis.repair.proof import Proof, Repair
from buggy_rl.diagnosis.residuals import READINGS, Unexplained
from buggy_rl.diagnosis.search.by_recording import Difference
from buggy_rl.diagnosis.search.candidate import excess_misfit
from buggy_rl.diagnosis.search.posterior import Posterior
from buggy_rl.diagnosis.search.result import SearchResult

Verdict = Literal[
    "missing_physics", "wrong_parameters", "unknown_physics", "no_mismatch", "cannot_tell"
]
SCHEMA = 1
WRITTEN = 24  # hypotheses that are written down
SPOKEN = 5  # effects that get a sentence on the terminal; the report has all
OPEN = ("unknown_physics", "cannot_tell")  # verdicts after which no list of effects says it all
WORTH = 0.05  # [-] confidence from which an effect is said where something has no name
UNNAMED = 0.1  # [-] unexplained share from which the first line says it


@dataclass(frozen=True)
class Alternative:
    """A hypothesis that was fitted."""

    effects: tuple[str, ...]
    nats: float
    """Nats by which it is worse than the selected one."""
    excess: float
    """Excess misfit on what was held out."""
    log_evidence: float | None = None
    """[nats]"""

    @staticmethod
    def closest(found: SearchResult) -> list["Alternative"]:
        """The closest hypotheses of a search, best first."""
        own = found.loss(found.best)
        alternatives = [
            Alternative(
                effects,
                found.loss(c) - own,
                excess_misfit(c, found.null),
                found.log_evidence.get(effects),
            )
            for effects, c in found.tried.items()
        ]
        return sorted(alternatives, key=lambda a: a.nats)[:WRITTEN]

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return {
            "causes": self.effects,
            "nats": self.nats,
            "excess": self.excess,
            "log_evidence": self.log_evidence,
        }


@dataclass(frozen=True)
class Answer:
    """Everything that a diagnosis reports."""

    verdict: Verdict
    located: Located
    effects: list[NamedEffect]
    remaining: Unexplained
    proof: Proof
    weak: list[str]
    suggest: list[str]
    tried: list[Alternative] = field(default_factory=list)
    """The closest ones, best first."""
    notes: list[str] = field(default_factory=list)
    posterior: Posterior | None = None
    """Posterior of all sets that were fitted."""
    manoeuvres: list[DecisionRate] = field(default_factory=list)
    """How probably each decides between the leading hypotheses, the highest first."""
    equivalents: list[Equivalents] = field(default_factory=list)
    """Named effects with what these recordings cannot tell from them."""
    behaviours: list[Behaviour] = field(default_factory=list)
    """Quantities of step tests, as given and repaired."""
    sensors: list[SensorFinding] = field(default_factory=list)
    """What sensors beside the tracker say without a simulator."""
    form: list[FormFault] = field(default_factory=list)
    """Faults of form, where the repaired simulator is wrong to one side, the largest first."""
    repair: Repair = field(default_factory=Repair)
    """What `repaired.yaml` has, as it was validated."""
    layers: list[Layer] = field(default_factory=list)
    """Layers of the repaired simulator that were tried, in their order."""
    more: float = 0.0
    """Probability that more is missing than is named, whatever the probability of the names."""
    terms: list[NamedEffect] = field(default_factory=list)
    """Equations without a name that the car behaves like, of the layer of terms."""
    by_recording: list[Difference] = field(default_factory=list)
    """Effects that are others in each recording; they count as noise."""
    left_out: list[str] = field(default_factory=list)
    """Parts for which there was no time, in words; `notes` say it."""
    first: list[str] = field(default_factory=list)
    """What must be known before anything else, such as commands that do not predict the motion."""

    def to_dict(self) -> dict[str, Any]:
        """Makes the content of `diagnosis.json`."""
        return _finite(
            {
                "schema": SCHEMA,
                "verdict": self.verdict,
                "summary": self.lines(),
                "located": self.located.to_dict(),
                "effects": [e.to_dict() for e in (*self.effects, *self.terms)],
                "tried": [t.to_dict() for t in self.tried],
                "equivalents": [e.to_dict() for e in self.equivalents],
                "behaviours": [b.to_dict() for b in self.behaviours],
                "sensors": [s.to_dict() for s in self.sensors],
                "posterior": _posterior(self.posterior),
                "unexplained": {
                    "share": self.remaining.share,
                    "depends_on": self.remaining.depends_on,
                    "description": describe_unexplained(self.remaining),
                    "channel_share": self.remaining.channel,
                    "form": [f.to_dict() for f in self.form],
                },
                "fit": self.proof.to_dict(),
                "repair": self.repair.to_dict(),
                "layers": [layer.to_dict() for layer in self.layers],
                "more_is_missing": self.more,
                "by_recording": [d.to_dict() for d in self.by_recording],
                "excitation": {
                    "weak": self.weak,
                    "suggest": self.suggest,
                    "manoeuvres": [m.to_dict() for m in self.manoeuvres],
                },
                "notes": self.notes,
            }
        )

    @property
    def said(self) -> list[NamedEffect]:
        """Effects that are worth a sentence."""
        return [e for e in self.effects if worth_saying(self.verdict, e.kind, e.confidence)]

    def lines(self) -> list[str]:
        """The answer in a few sentences."""
        result = [*self.first, *self._apart(), self._headline()]
        if self.sensors:
            said = "; ".join(s.line() for s in self.sensors)
            result.append(f"Measured without a simulator: {said}.")
        open_ = self.verdict in OPEN
        if open_:
            result += self._differing()
        if self.verdict != "no_mismatch":
            channel, share = max(self.located.channel_share.items(), key=lambda i: i[1])
            result.append(
                f"The largest share of the error is in {READINGS[channel].words} ({share:.0%})."
            )
        result += self._findings(self.verdict == "unknown_physics")
        result += self._beyond()
        if open_ and self.form:
            where = "; ".join(fault.line() for fault in self.form)
            result.append(f"Where the repaired simulator is still wrong: {where}.")
        result += self.repair.lines(tuple(e.name for e in self.said))
        result += self.proof.lines()
        if self.suggest:
            result.append(f"Drive next: {'; then: '.join(self.suggest)}.")
        elif open_ and self.weak:
            result.append(f"Hardly driven: {'; '.join(self.weak)}.")
        return result

    def _apart(self) -> list[str]:
        """What recordings do not share, in a sentence."""
        if not self.by_recording:
            return []
        each = " and ".join(difference.words() for difference in self.by_recording)
        return [
            f"The car differs from recording to recording, as by {each}: that closes "
            f"{self.by_recording[0].closes:.0%} of what is left, and counts as noise."
        ]

    def _beyond(self) -> list[str]:
        """What lies upon what has a name, how much that is worth, and its equations."""
        upon = [layer for layer in self.layers if layer.kept and layer.kind != "effects"]
        if not upon:
            return []
        what = " and ".join(_in_words(layer.kind, len(layer.names)) for layer in upon)
        nearer = 1.0 - math.prod(1.0 - layer.nearer for layer in upon)
        than = "is named" if self.said else "the library's effects say"
        lines = [
            f"More is missing than {than}, probability {min(self.more, SUREST):.0%}: with {what}, "
            f"held-out rollouts are {nearer:.0%} nearer."
        ]
        for term in self.terms:
            alike = f"; over what was driven the same as {', '.join(term.alike)}" * bool(term.alike)
            open_ = "; its number may be 0" * bool(term.undetermined)
            said = f"{term.sentence[:1].upper()}{term.sentence[1:]}"
            lines.append(f"{said} [{term.name}: {term.equation}{open_}{alike}].")
        return lines

    def _differing(self) -> list[str]:
        """What the car does otherwise, whichever parameters or effects are to blame."""
        lines = [f"Whatever is to blame: {b.line()}." for b in differing(self.behaviours)]
        return lines[:SPOKEN]

    def _findings(self, unknown: bool) -> list[str]:
        """A sentence for each effect, or for it and what cannot be told from it.

        Parameters that were re-tuned together are one finding: none was tested apart.
        """
        merged = {e.effects[0]: e for e in self.equivalents}
        own = [e for e in self.said if unknown and e.kind == "parameter"]
        others = [e for e in self.said if e not in own]
        lines = [
            merged[e.name].line() if e.name in merged else e.line(unknown) for e in others[:SPOKEN]
        ]
        if more := [e.name for e in others[SPOKEN:]]:
            lines.append(f"And {', '.join(more)}: see the report.")
        return [*_retuned(own), *lines]

    def _headline(self) -> str:
        first = {
            "missing_physics": "Physics is missing from the simulator",
            "wrong_parameters": "The simulator's parameters are wrong",
            "unknown_physics": "Physics is missing that no effect in the library describes",
            "no_mismatch": "Simulator and recordings agree within the sensor noise",
            "cannot_tell": "These data do not decide which physics is missing",
        }[self.verdict]
        share = self.remaining.share
        unknown, said = self.verdict == "unknown_physics", self.said
        if unknown and all(e.varies_with for e in said):
            if said:
                first += "; the effects named here fit, but are probably misspecified"
        elif unknown:
            first = (
                f"What is named here explains {1 - share:.0%} of the residual; the rest has a form "
                "that no effect in the library has"
            )
        elif self.effects and share >= UNNAMED:
            first += f"; {share:.0%} of the residual is unexplained"
        elif self.verdict == "wrong_parameters":
            first += "; no physics is missing"
        if self.by_recording:
            first = f"Beside that: {first[:1].lower()}{first[1:]}"
        return f"{first}."


def worth_saying(verdict: Verdict, kind: str, confidence: float) -> bool:
    """Whether an effect gets a sentence: where something has no name, an improbable one does not.

    Args:
        verdict: Of the answer.
        kind: Of the effect; parameters that were re-tuned and equations stand in the repair.
        confidence: Of the effect.
    """
    return verdict != "unknown_physics" or kind in ("parameter", "term") or confidence >= WORTH


def _in_words(kind: str, count: int) -> str:
    """A layer in words."""
    if kind == "terms":
        return "an equation" if count == 1 else f"{count} equations"
    return {"parameters": "its own parameters fitted", "residual": "a learned residual"}[kind]


def describe_unexplained(remaining: Unexplained) -> str:
    """What a hypothesis leaves, in words; never the name of an effect."""
    if remaining.excess < 0.1:
        return "What remains is noise."
    channel = max(remaining.channel.items(), key=lambda i: i[1])[0]
    grows = f"; it grows with {' and '.join(remaining.depends_on)}" if remaining.depends_on else ""
    memory = "; it persists over time, as with a latent state" if remaining.memory else ""
    return f"The unexplained residual is largest in {channel}{grows}{memory}."


def _retuned(own: Sequence[NamedEffect]) -> list[str]:
    """The simulator's own parameters that are off, in one sentence."""
    if not own:
        return []
    parts = []
    for e in own:
        [(name, v)] = e.parameters.items()
        unit = f" {v.unit}" if v.unit not in ("", "-") else ""
        was = e.sentence.rpartition("not ")[2]
        parts.append(
            f"{name.replace('_', ' ')} {v.value:.3g}{unit} ({v.low:.3g} to {v.high:.3g}), not {was}"
        )
    return [
        f"Parameters that are off where all are re-tuned (with a probability of "
        f"{1 - own[0].confidence:.0%} more is missing than they say): {'; '.join(parts)}."
    ]


def _posterior(posterior: Posterior | None) -> dict[str, Any] | None:
    """Probabilities of nothing, unknown and all sets, the most probable first; they sum to 1."""
    if posterior is None:
        return None
    ranked = sorted(posterior.sets.items(), key=lambda item: -item[1])
    return {
        "nothing": posterior.nothing,
        "unknown": posterior.unknown,
        "sets": [{"effects": effects, "probability": p} for effects, p in ranked if effects],
    }


def _finite(value: Any) -> Any:
    """Numbers that are not finite become null, as JSON requires."""
    if isinstance(value, Mapping):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
