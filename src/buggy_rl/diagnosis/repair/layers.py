"""Layers of a repaired simulator, each kept for what it brings where nothing was fitted to.

Upon what is named: parameters of the simulator's own, terms, which are equations without a name,
and a learned residual acceleration, each fitted with those below in place. What comes of it is not
farther from what was held out than the simulator as given, its parameters alone, or the learned
residual alone: where one of those is nearer, by more than the standard error, it is the repair.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

from scipy.stats import t as student_t
from torch import Tensor

from buggy_rl.diagnosis.repair.validation import SAID, Errors, Stack, Validation, retunable
from buggy_rl.diagnosis.run.budget import FULL
from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.search.candidate import Candidate
from buggy_rl.diagnosis.search.result import State, tried_too
from buggy_rl.diagnosis.search.terms import Discovery, discovered
from buggy_rl.effects.terms.grammar import PREFIX
from buggy_rl.estimation.evidence import blocks, closeness, mean_of_blocks, misfit
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.hypothesis import OWN, Hypothesis
from buggy_rl.estimation.residual_process import Recipe

Kind = Literal["effects", "parameters", "terms", "residual"]
ENDED = 1.05  # [-] misfit below which nothing is laid on: what is left is noise; chosen
WORTH = 0.02  # [-] gain, or loss of the median distance, that does not count: 2 %; chosen
MATTERS = 0.1  # [-] of what all layers gain: less beside a name is no more that is missing; chosen
SURE = 1.0  # [standard errors] that a layer gains at least; chosen
SURELY = 2.0  # [standard errors] by which what is simpler must be nearer to be delivered; chosen
NEAR = 1e-3  # [m] as which a distance counts at least: within the noise of any tracker


def by_seconds(values: Mapping[str, float]) -> dict[float, float]:
    """Values by horizon [s] of those in `diagnosis.json`, which stand by its words."""
    return {float(horizon.removesuffix(" s")): value for horizon, value in values.items()}


@dataclass(frozen=True)
class Layer:
    """A layer that was tried."""

    kind: Kind
    names: tuple[str, ...]
    """Effects, parameters or terms of it; none for a residual."""
    gain: float
    """[-] mean over blocks of the log of how many times nearer rollouts come by it."""
    error: float
    """Standard error of the gain."""
    kept: bool
    median: Mapping[float, float] = field(default_factory=dict)
    """Horizon [s] -> median distance [m] on what was held out, with it and those kept below it."""
    blocks: int = 1
    """Blocks that the gain is a mean of."""
    fitted: Candidate | None = None
    """Candidate of a layer of terms: fitted beside what is below them, and cross-validated."""
    alike: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Term -> terms that are the same over what was driven."""

    @property
    def nearer(self) -> float:
        """Share by which it brings rollouts nearer, in the mean of the logarithm."""
        return 1.0 - math.exp(-max(self.gain, 0.0))

    @property
    def probability(self) -> float:
        """Probability that it brings rollouts nearer."""
        return probably_over(0.0, self.gain, self.error, self.blocks)

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return {
            "kind": self.kind,
            "names": list(self.names),
            "gain": self.gain,
            "standard_error": self.error,
            "probability": self.probability,
            "kept": self.kept,
            "position_median": {f"{horizon:g} s": of for horizon, of in self.median.items()},
        }

    @classmethod
    def of(cls, entry: Mapping[str, Any]) -> Self:
        """The layer of an entry, without what was fitted."""
        names, gain, error = tuple(entry["names"]), entry["gain"], entry["standard_error"]
        median = by_seconds(entry["position_median"])
        return cls(entry["kind"], names, gain, error, entry["kept"], median)


@dataclass(frozen=True, eq=False)
class Layered:
    """A stack and how it came about."""

    layers: tuple[Layer, ...]
    """Layers that were tried, in their order."""
    start: Hypothesis
    """Effects, parameters and terms that were kept."""
    residual: Recipe | None
    """Recipe of the learned residual, where one is laid on."""
    errors: Errors
    """Errors on what was held out."""
    more: float = 0.0
    """Probability that more is missing than is named: that what lies upon that, or was tried,
    brings rollouts nearer by more than `WORTH`, and than `MATTERS` of what all layers do; 0 where
    only noise is left."""


def layered(
    validation: Validation,
    criteria: Criteria,
    named: Hypothesis,
    stacks: Mapping[str, Stack],
    errors: Mapping[str, Errors],
    name: str,
    looked_at: int = FULL.terms,
) -> Layered:
    """Lays upon what is named what else brings rollouts nearer.

    Args:
        validation: Of the simulator as given.
        criteria: Of the search.
        named: What is named, about the simulator as given; nothing, where `name` is `before`.
        stacks: `before`, `retuned`, `black_box` and that of `name`.
        errors: Of them.
        name: Of the stack of what is named.
        looked_at: Segments on which terms are screened; 0 for no terms.
    """
    problem = validation.problem
    group = blocks(problem.segments)
    count = len(group.unique())
    start, now, stack = named.as_stamped, errors[name], stacks[name]
    alone = now
    layers: list[Layer] = []

    def tried(kind: Kind, names: Sequence[str], than: Errors, with_it: Errors) -> bool:
        gain, error = mean_of_blocks(_closeness(than) - _closeness(with_it), group)
        kept = is_worth(gain, error) and not is_farther(with_it, than, group)
        median = dict(with_it.median)
        layers.append(Layer(kind, tuple(names), gain, error, kept, median, count))
        return kept

    if named.effects and not tried("effects", named.effects, errors["before"], now):
        nothing = problem.library.hypothesis(())
        start, now, stack = nothing.as_stamped, errors["before"], stacks["before"]
    own = [n for n in retunable(problem.library) if n not in start.effects]
    if own and _more_is_wrong(now):
        more = problem.library.at((*start.effects, *own), start.named())
        fits = validation.refitted({"own": more})["own"]
        beside = validation.errors({"own": Stack(fits)})["own"]
        if tried("parameters", own, now, beside):
            start, now, stack = more.as_stamped, beside, Stack(fits)
    if looked_at and _more_is_wrong(now):
        fits = _with_terms(validation, criteria, start, stack.fits, looked_at)
        added = _terms_of(fits[0].effects)
        if added:
            beside = validation.errors({"terms": Stack(fits)})["terms"]
            if tried("terms", added, now, beside):
                found = _discovered(problem, criteria, start, looked_at)
                chosen = _terms_of(found.best.effects)
                layers[-1] = replace(layers[-1], names=chosen, fitted=found.best, alike=found.alike)
                start, now, stack = found.best.fit.as_stamped, beside, Stack(fits)
    residual = None
    if _more_is_wrong(now):
        learned = validation.residuals(stack.fits)
        beside = validation.errors({"residual": Stack(stack.fits, learned)})["residual"]
        if tried("residual", (), now, beside):
            residual, now = learned.recipe, beside
    found = _at_least(Layered(tuple(layers), start, residual, now), validation, stacks, errors)
    return replace(found, more=_more_missing(errors["before"], alone, found, group))


def _with_terms(
    validation: Validation,
    criteria: Criteria,
    start: Hypothesis,
    fits: Sequence[Hypothesis],
    looked_at: int,
) -> list[Hypothesis]:
    """Hypotheses of the folds with the terms that each one's other recordings call for.

    Terms are chosen out of hundreds: what a choice brings is seen where it was not made. All have
    the terms of all folds, at nothing where a fold has not chosen them.
    """
    problem, chosen = validation.problem, []
    for aside, fit in zip(validation.aside, fits, strict=True):
        rest = validation.rest(aside)
        own = replace(criteria, group=criteria.group[rest])
        begun = problem.library.at(start.effects, fit.named())
        found = _discovered(problem[rest], own, begun, looked_at)
        chosen.append(found.best.fit.as_stamped)
    terms = dict.fromkeys(name for one in chosen for name in _terms_of(one.effects))
    if not terms:
        return list(fits)
    starts = {str(fold): one for fold, one in enumerate(chosen)}
    refits = validation.refitted(starts)
    ends = [refits[name][fold].named() for fold, name in enumerate(starts)]
    return [problem.library.at((*start.effects, *terms), end).as_stamped for end in ends]


def _discovered(
    problem: Problem, criteria: Criteria, start: Hypothesis, looked_at: int
) -> Discovery:
    base = problem.library.at(start.effects, start.named())
    _, [candidate] = tried_too(State(problem, {}), [base], criteria)
    return discovered(problem, criteria, candidate, looked_at=looked_at)


def _terms_of(effects: Sequence[str]) -> tuple[str, ...]:
    return tuple(name for name in effects if name.startswith(PREFIX))


def _more_missing(before: Errors, alone: Errors, found: Layered, group: Tensor) -> float:
    """`Layered.more`.

    Args:
        before: Errors of the simulator as given,
        alone: with what is named and nothing else,
        found: and with all that is laid upon it.
        group: Block [N] of each segment.
    """
    count = len(group.unique())
    closed, _ = mean_of_blocks(_closeness(before) - _closeness(found.errors), group)
    least = max(WORTH, MATTERS * closed)
    gains = [mean_of_blocks(_closeness(alone) - _closeness(found.errors), group)]
    gains += [(layer.gain, layer.error) for layer in found.layers if layer.kind != "effects"]
    beyond = gains[:1] if any(x.kept for x in found.layers if x.kind != "effects") else gains[1:]
    return max((probably_over(least, *each, count) for each in beyond), default=0.0)


def probably_over(least: float, mean: float, error: float, count: int) -> float:
    """Probability that a mean is larger than `least`, by Student's t; even odds of one number.

    Args:
        least: What it is compared with.
        mean: As it was found,
        error: with its standard error,
        count: of so many independent numbers.
    """
    if count < 2 or error <= 0:
        return 0.5
    return float(student_t.cdf((mean - least) / error, count - 1))


def is_worth(gain: float, error: float) -> bool:
    """Whether a gain, with its standard error, is one that counts."""
    return gain > max(SURE * error, WORTH)


def is_farther(errors: Errors, than: Errors, group: Tensor) -> bool:
    """Whether rollouts are farther in distance, although maybe nearer in all channels.

    By the pairs of segments: a difference of two medians of the same is mostly noise.

    Args:
        errors: With what is laid on,
        than: and without it.
        group: Block [N] of each segment.
    """
    gain, error = _gain_in_distance(errors, than, group)
    return is_worth(-gain, error)


def _gain_in_distance(errors: Errors, than: Errors, group: Tensor) -> tuple[float, float]:
    """Mean over blocks of the log of how many times nearer in distance, and its standard error."""
    near, far = (e.distance.clamp_min(NEAR).log() for e in (errors, than))
    return mean_of_blocks(far - near, group)


def _more_is_wrong(errors: Errors) -> bool:
    return misfit(errors.sensed) > ENDED


def _at_least(
    found: Layered,
    validation: Validation,
    stacks: Mapping[str, Stack],
    errors: Mapping[str, Errors],
) -> Layered:
    """The stack, or what anyone would try first, where that is nearer to what was held out."""
    library = validation.problem.library
    group = blocks(validation.problem.segments)
    nothing = library.hypothesis(()).as_stamped
    alone = stacks["black_box"].residuals
    simple = {
        "before": (nothing, None),
        "retuned": (library.hypothesis(retunable(library)).as_stamped, None),
        "black_box": (nothing, alone.recipe if alone else None),
    }
    best = found
    for name, (start, residual) in simple.items():
        if name not in errors:
            continue
        if _is_nearer(errors[name], best.errors, group):
            gain, error = mean_of_blocks(_closeness(best.errors) - _closeness(errors[name]), group)
            layers = tuple(replace(layer, kept=False) for layer in found.layers)
            kind: Kind = "residual" if residual else "parameters"
            own = tuple(n.removeprefix(OWN) for n in start.effects)
            count = len(group.unique())
            layer = Layer(kind, own, gain, error, True, dict(errors[name].median), count)
            best = Layered((*layers, layer), start, residual, errors[name])
    return best


def _is_nearer(errors: Errors, than: Errors, group: Tensor) -> bool:
    """Whether rollouts are surely nearer, so that an explanation gives way.

    By more than `NEAR`, and in all channels together; or by their distances, and not farther in all
    channels.
    """
    if not errors.median.get(SAID, 0.0) < than.median.get(SAID, 0.0) - NEAR:
        return False
    gain, error = mean_of_blocks(_closeness(than) - _closeness(errors), group)
    if gain > max(SURELY * error, WORTH):
        return True
    if not len(errors.distance) or gain < -error:
        return False
    gain, error = _gain_in_distance(errors, than, group)
    return gain > max(SURELY * error, WORTH)


def _closeness(errors: Errors) -> Tensor:
    """`closeness` [N] in deviations of the sensor."""
    return closeness(errors.sensed)
