"""What is delivered, and what speaks for it: the set whose repair predicts what was held out.

A repair is validated as it is delivered, commands as they are stamped, and none is delivered that
makes rollouts of held-out data worse. Its proof are errors on what was held out: as given,
repaired, re-tuned, learned.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from torch import Tensor

from buggy_rl.diagnosis.repair.layers import layered
from buggy_rl.diagnosis.repair.validation import (
    SAID,
    Errors,
    Validation,
    delivered,
    segment_folds,
    validated,
)
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.search.candidate import Candidate
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.effects.residual_models import Residual
from buggy_rl.effects.terms.grammar import PREFIX
from buggy_rl.estimation.evidence import misfit
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.hypothesis import Hypothesis
from buggy_rl.estimation.rollout import AS_GIVEN, ParameterSets, Simulation

SLACK = 0.02  # [-] share by which a median distance may seem larger without being worse; chosen
OTHER = "other"  # name of the second candidate's errors


@dataclass(frozen=True)
class Repair:
    """What `repaired.yaml` has beyond the simulator as given."""

    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Effect, or `parameter:NAME` -> number -> value, about the simulator as given."""
    median: Mapping[float, float] = field(default_factory=dict)
    """Horizon [s] -> median distance [m] of rollouts of the file on all that it was fitted to."""
    refused: tuple[str, ...] = ()
    """Effects that were fitted and would make held-out rollouts worse."""
    worse: tuple[float, float] | None = None
    """[m] median distance after `SAID` without and with them, where they were refused."""
    residual: Residual | None = None
    """A learned acceleration on top, where it brings held-out rollouts nearer; with that of a
    baseline."""
    fit: Hypothesis | None = None
    """Numbers of the file, about the simulator as given."""

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of what is in it."""
        return tuple(self.values)

    @property
    def is_one(self) -> bool:
        """Whether it differs from the simulator as given."""
        return bool(self.values) or self.residual is not None

    def simulation(self, case: DiagnosisCase) -> tuple[Simulation, ParameterSets]:
        """The repaired simulator over a case's drives, and its numbers; or that as given."""
        simulation, settings = case.given, AS_GIVEN
        if self.residual is not None:
            dt = case.problem.segments.dt
            learned = ResidualAcceleration(model=self.residual, strength=1.0, dt=dt)
            simulation = replace(simulation, standing=(learned,))
        if self.fit is not None:
            settings = case.as_given.settings([(self.fit, self.fit.vector)])
        return simulation, settings

    def lines(self, named: tuple[str, ...]) -> list[str]:
        """What a reader of the names could not guess of the file.

        Args:
            named: Effects that the answer names.
        """
        if self.refused:
            distance = ""
            if self.worse is not None:
                without, given = (f"{1000 * of:.0f} mm" for of in self.worse)
                distance = f" (median position error {without} without, {given} with it)"
            what = (
                "has other layers" if self.values or self.residual else "is the simulator as given"
            )
            return [
                f"repaired.yaml {what}: {', '.join(self.refused)} would make "
                f"held-out rollouts worse{distance}."
            ]
        own = [name for name in self.effects if not name.startswith("parameter:")]
        gone = [n for n in named if n not in self.effects and not n.startswith("parameter:")]
        if gone and any(name.startswith(PREFIX) for name in own):
            return [f"repaired.yaml has no {', '.join(gone)}: beside its equations it needs none."]
        if gone and self.fit is not None:
            return [
                f"repaired.yaml has no {', '.join(gone)}: held-out rollouts are not surely nearer "
                "with it."
            ]
        if set(own) <= set(named):
            return []
        return [
            f"repaired.yaml has {', '.join(own)}: the set that predicts held-out rollouts best, "
            "whether or not each is what the car has."
        ]

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return {
            "values": {effect: dict(own) for effect, own in self.values.items()},
            "position_median": {f"{horizon:g} s": of for horizon, of in self.median.items()},
            "refused": list(self.refused),
        }


def repair_candidates(found: SearchResult) -> list[Candidate]:
    """Sets whose repair is validated, the preferred one first; the empty one is none."""
    first, second = found.best, found.predictive
    if found.posterior.says == "unknown":
        first, second = second, first
    chosen = [first] if found.posterior.says == "nothing" else [first, second]
    return [c for i, c in enumerate(chosen) if c not in chosen[:i]]


def chosen(errors: Mapping[str, Errors], unknown: bool) -> str:
    """Name of the errors of the set that is delivered; `before` where each would be worse.

    Args:
        errors: `before`, `after` of the preferred set, and maybe `OTHER`.
        unknown: Whether what predicts best is asked for, rather than what is most probable.
    """
    before = errors["before"]
    names = [n for n in ("after", OTHER) if n in errors and not is_worse(errors[n], before)]
    if unknown:
        names.sort(key=lambda name: misfit(errors[name].square, before.square))
    return names[0] if names else "before"


def is_worse(errors: Errors, before: Errors) -> bool:
    """Whether held-out rollouts are farther off, by misfit or by the median distance."""
    given: Tensor = before.square
    if misfit(errors.square, given) > misfit(given, given):
        return True
    then, now = (e.median.get(SAID, 0.0) for e in (before, errors))
    return now > (1 + SLACK) * then


OTHERS = {"retuned": "re-tuned alone", "black_box": "with a learned residual"}
BETTER = 0.8  # [-] of the repair's error, below which a learned residual is worth a word; chosen


@dataclass(frozen=True)
class Proof:
    """Rollouts on what was held out, by horizon in seconds; position errors as mean squares."""

    before: dict[float, float]
    after: dict[float, float]
    retuned: dict[float, float]
    noise_floor: dict[float, float]
    """Errors of a simulator without fault: of its sensor, and of starts that are smoothed."""
    black_box: dict[float, float]
    misfit_before: float
    """Root mean square of the standardised residuals of 1 s rollouts."""
    misfit_after: float
    held_out: bool
    median: dict[str, dict[float, float]] = field(default_factory=dict)
    """before, after, retuned, black_box, noise_floor -> horizon -> median distance [m]; robust to
    spins."""

    def better_than(self, other: "Proof") -> bool:
        """Whether both its misfit and its median distance after the longest rollouts are smaller.

        Where most segments are far beyond the noise, the cap on each makes the misfit insensitive.
        """
        own, its = (max(p.median.get("after", {}).items(), default=(0, 0.0)) for p in (self, other))
        return self.misfit_after < other.misfit_after and own[1] <= its[1]

    @property
    def prefers_retuning(self) -> bool:
        """Whether parameters fitted alone predict what was held out better than what is named."""
        tuned, after = (self.median.get(name, {}).get(SAID) for name in ("retuned", "after"))
        if tuned is None or after is None:
            return False
        return tuned < after and self.retuned[SAID] < self.after[SAID]

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`, under `fit`."""
        squares = ("before", "after", "retuned", "noise_floor", "black_box")
        return {
            "metric": "1 s open-loop",
            "before": self.misfit_before,
            "after": self.misfit_after,
            "noise_floor": 1.0,
            "held_out": self.held_out,
            "position_mse_before": self.before.get(SAID),
            "position_mse_after": self.after.get(SAID),
            "position_mse": {name: _by_horizon(getattr(self, name)) for name in squares},
            "position_median": {name: _by_horizon(of) for name, of in self.median.items()},
        }

    def lines(self) -> list[str]:
        """The error before and after the repair, and what simpler repairs come to."""
        if SAID not in self.before or SAID not in self.after:
            return []
        data = "held-out data" if self.held_out else "the data that were fitted"
        root = _millimetres(math.sqrt(self.before[SAID]), math.sqrt(self.after[SAID]))
        words = f"root mean square {root}"
        if {"before", "after"} <= set(self.median):
            median = _millimetres(self.median["before"][SAID], self.median["after"][SAID])
            words = f"median {median}; {words}"
        return [f"Position error of 1 s rollouts on {data}: {words}.", *self._others()]

    def _others(self) -> list[str]:
        """Median errors of what anyone would try first."""
        of: Mapping[str, dict[float, float]] = self.median
        parts = [
            f"{1000 * of[name][SAID]:.0f} mm {words}"
            for name, words in OTHERS.items()
            if math.isfinite(of.get(name, {}).get(SAID, math.nan))
        ]
        if not parts:
            return []
        after, learned = (of.get(name, {}).get(SAID, math.nan) for name in ("after", "black_box"))
        more = ", which is in no file: it shows how much is still to be named"
        return [
            f"In comparison, median: {', '.join(parts)}{more if learned < BETTER * after else ''}."
        ]


def _by_horizon(values: Mapping[float, float]) -> dict[str, float]:
    return {f"{horizon:g} s": value for horizon, value in values.items()}


def _millimetres(before: float, after: float) -> str:
    return f"{1000 * before:.0f} mm before, {1000 * after:.0f} mm after"


def answer_section(case: DiagnosisCase, found: SearchResult) -> Mapping[str, Any]:
    """The part of the answer that says what is delivered, and what speaks for it.

    Sets of effects that may be delivered are validated; one of them is delivered, or none.
    """
    problem, every = case.problem, [c.fit for c in repair_candidates(found)]
    if case.retuned_from is not None:
        # Its parameters have seen all recordings: they are fitted anew with the effects', from the
        # simulator as given, on what is not held out.
        simulation = replace(problem.simulation, make=case.given.make)
        problem = replace(problem, simulation=simulation)
        every = [case.about_given(fit) for fit in every]
    problem = replace(problem, library=case.as_given, dispersion=1.0)
    starts: dict[str, Hypothesis] = dict(zip(("after", OTHER), every, strict=False))
    second = {name: fit for name, fit in starts.items() if name != "after"}
    plenty = case.drives.plenty
    validation = Validation(problem, case.drives.longer, case.budget, plenty)
    stacks, errors = validated(validation, every[0], second)
    name = chosen(errors, found.posterior.says == "unknown")
    refused = every[0].effects if name == "before" else ()
    worse = tuple(errors[n].median.get(SAID) for n in ("before", "after")) if refused else ()
    named = starts.get(name, problem.library.hypothesis(()))
    done = layered(validation, case.criteria, named, stacks, errors, name, case.budget.terms)
    file = delivered(problem, done.start, validation.iterations, done.residual, plenty)
    repair = Repair(
        values=file.fit.values(),
        median=file.errors.median if file.fit.effects or done.residual is not None else {},
        refused=refused,
        worse=None if None in worse or not worse else worse,  # type: ignore[arg-type]
        residual=file.residual,
        fit=file.fit,
    )
    errors = {n: e for n, e in errors.items() if n != OTHER} | {"after": done.errors}
    errors["noise_floor"] = validation.floor(file.fit)
    proof, layers = _proof(problem, errors), list(done.layers)
    return {"proof": proof, "repair": repair, "layers": layers, "more": done.more}


def _proof(problem: Problem, errors: dict[str, Errors]) -> Proof:
    """Errors of rollouts by what they are of, beside those of a simulator without fault."""
    before, given, none = errors["before"].mean_square, errors["before"].square, Errors()
    return Proof(
        before=before,
        after=errors["after"].mean_square,
        retuned=errors.get("retuned", none).mean_square,
        noise_floor=errors["noise_floor"].mean_square,
        black_box=errors["black_box"].mean_square,
        median={name: e.median for name, e in errors.items()},
        misfit_before=misfit(given, given),
        misfit_after=misfit(errors["after"].square, given),
        held_out=len(segment_folds(problem.segments).unique()) > 1,
    )
