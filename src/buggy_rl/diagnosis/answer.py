"""What the diagnosis says: the file that programs read, and five lines for a person."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from buggy_rl.diagnosis.constancy import WORDS
from buggy_rl.diagnosis.localisation import Located
from buggy_rl.diagnosis.unexplained import Remaining
from buggy_rl.effects import effect_class

Verdict = Literal[
    "missing_physics", "wrong_parameters", "unknown_physics", "no_mismatch", "cannot_tell"
]
SCHEMA = 1
SPOKEN = 5  # causes of which a sentence is said on the terminal
NORMAL = 1.96  # standard deviations of a 95 % interval
UNNAMED = 0.1  # share of the gap that remains, of which the first line says so


@dataclass(frozen=True)
class Value:
    """A fitted number with the bounds of its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Named:
    """One cause that the drives speak for."""

    name: str
    kind: Literal["actuation", "motion", "sensing", "parameter"]
    equation: str
    sentence: str
    parameters: dict[str, Value]
    confidence: float
    held_out_gain: float
    """Share of the gap that is lost again without it, on what was held out."""
    confused_with: dict[str, float] = field(default_factory=dict)
    """Rivals and how probable they are instead."""
    at_bound: tuple[str, ...] = ()
    """Parameters that lie at the end of their range."""
    varies_with: str = ""
    """Condition with which its parameters change: then it is rather a lookalike."""

    @property
    def sound(self) -> float:
        """How likely it is right if none of its rivals is: what remains alone speaks against it."""
        alone = 1.0 - sum(self.confused_with.values())
        return self.confidence / alone if alone > self.confidence else 1.0


@dataclass(frozen=True)
class Tried:
    """An explanation that was fitted."""

    causes: tuple[str, ...]
    nats: float
    """By which it is worse than what is said."""
    excess: float
    """Of gaps over the noise's, on what was held out."""


@dataclass(frozen=True)
class Proof:
    """Rollouts on what was held out, by horizon in seconds; position errors as mean squares."""

    before: dict[float, float]
    after: dict[float, float]
    retuned: dict[float, float]
    noise_floor: dict[float, float]
    black_box: dict[float, float]
    misfit_before: float
    """Root mean square of the 1 s gaps, in units of the noise."""
    misfit_after: float
    held_out: bool
    median: dict[str, dict[float, float]] = field(default_factory=dict)
    """before, after, retuned, black_box -> horizon -> median distance [m]: no spin outweighs it."""

    def better_than(self, other: "Proof") -> bool:
        """Whether it leaves less, in units of the noise as in metres after the longest rollouts.

        Where most stretches are far beyond the noise, the first hardly tells: each counts as no
        more than the cap.
        """
        own, its = (max(p.median.get("after", {}).items(), default=(0, 0.0)) for p in (self, other))
        return self.misfit_after < other.misfit_after and own[1] <= its[1]


@dataclass(frozen=True)
class Answer:
    """Everything that is said."""

    verdict: Verdict
    located: Located
    effects: list[Named]
    remaining: Remaining
    proof: Proof
    weak: list[str]
    suggest: list[str]
    tried: list[Tried] = field(default_factory=list)
    """The closest ones, best first."""
    notes: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """As `diagnosis.json` has it (contract 3), and what was added since."""
        p = self.proof
        return _finite(
            {
                "schema": SCHEMA,
                "verdict": self.verdict,
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
                "tried": [vars(t) for t in self.tried],
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
        """The answer in a few lines of plain words."""
        share = max(self.located.channel_share.items(), key=lambda i: i[1])
        words = {"vx": "speed", "vy": "sideways speed", "yaw_rate": "turning"}
        result = [self._headline()]
        if self.verdict != "no_mismatch":
            result.append(f"It shows most in {words[share[0]]} ({share[1]:.0%} of the error).")
        for e in self.effects[:SPOKEN]:
            rivals = [f"{n} ({p:.0%})" for n, p in e.confused_with.items()]
            other = f"; could also be {', '.join(rivals)}" if rivals else ""
            if e.varies_with:
                other += f"; it changes with {WORDS[e.varies_with]}: rather a lookalike"
            if e.at_bound:
                other += f"; at the end of its range: {', '.join(e.at_bound)}"
            sentence = e.sentence[:1].upper() + e.sentence[1:]
            result.append(f"{sentence} [{e.name}, {e.confidence:.0%} sure{other}].")
        if more := [e.name for e in self.effects[SPOKEN:]]:
            result.append(f"And {', '.join(more)}: see the report.")
        p = self.proof
        if 1.0 in p.before and 1.0 in p.after:
            held_out = "held out" if p.held_out else "of the very drives it was fitted to"
            root = (math.sqrt(p.before[1.0]), math.sqrt(p.after[1.0]))
            words = [f"root mean square: {_millimetres(*root)}"]
            if {"before", "after"} <= set(p.median):
                middle = (p.median["before"][1.0], p.median["after"][1.0])
                words.insert(0, f"median: {_millimetres(*middle)}")
            result.append(f"1 s rollouts {held_out}, {'; '.join(words)}.")
        if self.suggest:
            result.append(f"Drive next: {'; then: '.join(self.suggest)}.")
        return result

    def _headline(self) -> str:
        first = {
            "missing_physics": "Physics is missing from the simulator",
            "wrong_parameters": "The simulator's parameters are off",
            "unknown_physics": "Something is missing that is not in the library",
            "no_mismatch": "Simulator and drives agree as well as the sensor can tell",
            "cannot_tell": "These drives cannot tell for sure what is missing",
        }[self.verdict]
        share = self.remaining.share
        if self.verdict == "unknown_physics" and all(e.varies_with for e in self.effects):
            if self.effects:
                first += ", and resembles what is named here"
        elif self.verdict == "unknown_physics" and self.effects:
            first = f"Part of what is missing has a name, {share:.0%} has none"
        elif self.effects and share >= UNNAMED:
            first += f", and {share:.0%} of the gap has no name"
        elif self.verdict == "wrong_parameters":
            first += "; no physics is missing"
        return f"{first}."


def described(remaining: Remaining) -> str:
    """What remains, in words; never a name."""
    if remaining.excess < 0.1:
        return "What remains is noise."
    channel = max(remaining.channel.items(), key=lambda i: i[1])[0]
    grows = f", growing with {' and '.join(remaining.depends_on)}" if remaining.depends_on else ""
    memory = "; it goes on over time, as a hidden state would" if remaining.memory else ""
    return f"What remains lies mostly in {channel}{grows}{memory}."


def _millimetres(before: float, after: float) -> str:
    return f"{1000 * before:.0f} mm off before, {1000 * after:.0f} mm after"


def _named(e: Named) -> dict[str, Any]:
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
    }


def _finite(value: Any) -> Any:
    """Without what JSON has no word for: numbers that are none become null."""
    if isinstance(value, Mapping):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def sentence(cause: str, values: Mapping[str, float], unit: str = "", was: float = 0.0) -> str:
    """A cause in plain words."""
    if ":" in cause and cause.startswith("parameter:"):
        name = cause.partition(":")[2]
        value = f"{values[name]:.3g}" + (f" {unit}" if unit not in ("", "-") else "")
        return f"the simulator's {name.replace('_', ' ')} is {value}, not {was:.3g}"
    return effect_class(cause).sentence(values)
