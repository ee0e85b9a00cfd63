"""The answer of a diagnosis: `diagnosis.json` for programs, and a few sentences for a person."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from buggy_rl.diagnosis.constancy import WORDS
from buggy_rl.diagnosis.localisation import Located
from buggy_rl.diagnosis.posterior import STANDING, Posterior
from buggy_rl.diagnosis.unexplained import Unexplained
from buggy_rl.effects import effect_class

Verdict = Literal[
    "missing_physics", "wrong_parameters", "unknown_physics", "no_mismatch", "cannot_tell"
]
SCHEMA = 1
SPOKEN = 5  # effects that get a sentence on the terminal; the report has all
NORMAL = 1.96  # standard deviations of a 95 % interval
UNNAMED = 0.1  # [-] unexplained share from which the first line says it
CHANNELS = {"vx": "longitudinal speed", "vy": "lateral speed", "yaw_rate": "yaw rate"}


@dataclass(frozen=True)
class Value:
    """A fitted number with the bounds of its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class NamedEffect:
    """An effect that the search selected."""

    name: str
    kind: Literal["actuation", "motion", "sensing", "parameter"]
    equation: str
    sentence: str
    parameters: dict[str, Value]
    confidence: float
    held_out_gain: float
    """Share of the residual without it that it closes, on what was held out."""
    confused_with: dict[str, float] = field(default_factory=dict)
    """Alternative effects and their probabilities."""
    at_bound: tuple[str, ...] = ()
    """Parameters at a bound of their range."""
    varies_with: str = ""
    """Condition with which its parameters vary: then it is probably misspecified."""
    whatever_else: float = 0.0
    """Share of the probability of all sets of effects that those with it have."""
    inside: tuple[str, ...] = ()
    """Parameters of the simulator's own by which it is realised; none: it is wrapped around it."""

    @property
    def realised(self) -> str:
        """How the repaired simulator has it, as `diagnosis.json` says."""
        if not self.inside:
            return "effect"
        return f"parameter{'s' * (len(self.inside) > 1)} {', '.join(self.inside)}"


@dataclass(frozen=True)
class Alternative:
    """A hypothesis that was fitted."""

    effects: tuple[str, ...]
    nats: float
    """By which it is worse than the selected one."""
    excess: float
    """Excess misfit on what was held out."""
    log_evidence: float | None = None
    """[nats]"""


@dataclass(frozen=True)
class Proof:
    """Rollouts on what was held out, by horizon in seconds; position errors as mean squares."""

    before: dict[float, float]
    after: dict[float, float]
    retuned: dict[float, float]
    noise_floor: dict[float, float]
    black_box: dict[float, float]
    misfit_before: float
    """Root mean square of the standardised residuals of 1 s rollouts."""
    misfit_after: float
    held_out: bool
    median: dict[str, dict[float, float]] = field(default_factory=dict)
    """before, after, retuned, black_box -> horizon -> median distance [m]; robust to spins."""

    def better_than(self, other: "Proof") -> bool:
        """Whether both its misfit and its median distance after the longest rollouts are smaller.

        Where most segments are far beyond the noise, the cap on each makes the misfit insensitive.
        """
        own, its = (max(p.median.get("after", {}).items(), default=(0, 0.0)) for p in (self, other))
        return self.misfit_after < other.misfit_after and own[1] <= its[1]


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
    """Of all sets that were fitted."""

    def to_dict(self) -> dict[str, Any]:
        """As `diagnosis.json` has it."""
        p = self.proof
        return _finite(
            {
                "schema": SCHEMA,
                "verdict": self.verdict,
                "summary": self.lines(),
                "located": {
                    "channel_share": self.located.channel_share,
                    "regions": [
                        {
                            "where": {k: list(v) for k, v in r.where.items()},
                            "error_share": r.error_share,
                            "data_share": r.data_share,
                        }
                        for r in self.located.regions
                    ],
                    "intervals": [
                        {
                            "recording": i.recording,
                            "from": i.begin,
                            "to": i.end,
                            "error_share": i.error_share,
                        }
                        for i in self.located.intervals
                    ],
                    "lags": self.located.lags,
                },
                "effects": [_named(e) for e in self.effects],
                "tried": [
                    {
                        "causes": t.effects,
                        "nats": t.nats,
                        "excess": t.excess,
                        "log_evidence": t.log_evidence,
                    }
                    for t in self.tried
                ],
                "posterior": _posterior(self.posterior),
                "unexplained": {
                    "share": self.remaining.share,
                    "depends_on": self.remaining.depends_on,
                    "description": described(self.remaining),
                    "channel_share": self.remaining.channel,
                },
                "fit": {
                    "metric": "1 s open-loop",
                    "before": p.misfit_before,
                    "after": p.misfit_after,
                    "noise_floor": 1.0,
                    "held_out": p.held_out,
                    "position_mse_before": p.before.get(1.0),
                    "position_mse_after": p.after.get(1.0),
                    "position_mse": {
                        name: {f"{h:g} s": v for h, v in getattr(p, name).items()}
                        for name in ("before", "after", "retuned", "noise_floor", "black_box")
                    },
                    "position_median": {
                        name: {f"{h:g} s": v for h, v in of_horizon.items()}
                        for name, of_horizon in p.median.items()
                    },
                },
                "excitation": {"weak": self.weak, "suggest": self.suggest},
                "notes": self.notes,
            }
        )

    def lines(self) -> list[str]:
        """The answer in a few sentences."""
        result = [self._headline()]
        if self.verdict != "no_mismatch":
            channel, share = max(self.located.channel_share.items(), key=lambda i: i[1])
            result.append(
                f"The largest share of the error is in {CHANNELS[channel]} ({share:.0%})."
            )
        unknown = self.verdict == "unknown_physics"
        result += [_line(e, unknown) for e in self.effects[:SPOKEN]]
        if more := [e.name for e in self.effects[SPOKEN:]]:
            result.append(f"And {', '.join(more)}: see the report.")
        p = self.proof
        if 1.0 in p.before and 1.0 in p.after:
            data = "held-out data" if p.held_out else "the data that were fitted"
            root = _millimetres(math.sqrt(p.before[1.0]), math.sqrt(p.after[1.0]))
            words = f"root mean square {root}"
            if {"before", "after"} <= set(p.median):
                median = _millimetres(p.median["before"][1.0], p.median["after"][1.0])
                words = f"median {median}; {words}"
            result.append(f"Position error of 1 s rollouts on {data}: {words}.")
        if self.suggest:
            result.append(f"Drive next: {'; then: '.join(self.suggest)}.")
        return result

    def _headline(self) -> str:
        first = {
            "missing_physics": "Physics is missing from the simulator",
            "wrong_parameters": "The simulator's parameters are wrong",
            "unknown_physics": "Physics is missing that no effect in the library describes",
            "no_mismatch": "Simulator and recordings agree within the sensor noise",
            "cannot_tell": "These data do not decide which physics is missing",
        }[self.verdict]
        share = self.remaining.share
        if self.verdict == "unknown_physics" and all(e.varies_with for e in self.effects):
            if self.effects:
                first += "; the effects named here fit, but are probably misspecified"
        elif self.verdict == "unknown_physics" and self.effects:
            first = (
                f"The effects named here explain a part of the residual, {share:.0%} is unexplained"
            )
        elif self.effects and share >= UNNAMED:
            first += f"; {share:.0%} of the residual is unexplained"
        elif self.verdict == "wrong_parameters":
            first += "; no physics is missing"
        return f"{first}."


def described(remaining: Unexplained) -> str:
    """What a hypothesis leaves, in words; never the name of an effect."""
    if remaining.excess < 0.1:
        return "What remains is noise."
    channel = max(remaining.channel.items(), key=lambda i: i[1])[0]
    grows = f"; it grows with {' and '.join(remaining.depends_on)}" if remaining.depends_on else ""
    memory = "; it persists over time, as with a latent state" if remaining.memory else ""
    return f"The unexplained residual is largest in {channel}{grows}{memory}."


def _line(effect: NamedEffect, unknown: bool = False) -> str:
    """Sentence, name and confidence of an effect, and what speaks against it."""
    text = f"{effect.name}, confidence {effect.confidence:.0%}"
    if unknown and effect.whatever_else >= STANDING:
        text += f"; whatever else is missing: in {effect.whatever_else:.0%} of what may explain it"
    if effect.confused_with:
        others = ", ".join(f"{name} ({p:.0%})" for name, p in effect.confused_with.items())
        text += f"; alternatives: {others}"
    if effect.varies_with:
        text += f"; varies with {WORDS[effect.varies_with]}: probably misspecified"
    if effect.inside and effect.kind != "parameter":
        text += f"; in the simulator: {effect.realised}"
    if effect.at_bound:
        text += f"; at a bound of its range: {', '.join(effect.at_bound)}"
    return f"{effect.sentence[:1].upper()}{effect.sentence[1:]} [{text}]."


def _millimetres(before: float, after: float) -> str:
    return f"{1000 * before:.0f} mm before, {1000 * after:.0f} mm after"


def _named(e: NamedEffect) -> dict[str, Any]:
    return {
        "name": e.name,
        "kind": e.kind,
        "equation": e.equation,
        "sentence": e.sentence,
        "parameters": {k: vars(v) for k, v in e.parameters.items()},
        "confidence": e.confidence,
        "held_out_gain": e.held_out_gain,
        "confused_with": [{"name": n, "confidence": c} for n, c in e.confused_with.items()],
        "at_bound": list(e.at_bound),
        "varies_with": e.varies_with,
        "whatever_else": e.whatever_else,
        "realised": e.realised,
    }


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


def sentence(effect: str, values: Mapping[str, float], unit: str = "", was: float = 0.0) -> str:
    """An effect, or a wrong parameter of the simulator's own, in words."""
    if effect.startswith("parameter:"):
        name = effect.partition(":")[2]
        value = f"{values[name]:.3g}" + (f" {unit}" if unit not in ("", "-") else "")
        return f"the simulator's {name.replace('_', ' ')} is {value}, not {was:.3g}"
    return effect_class(effect).sentence(values)
