"""Weights of the posterior, fitted to development cases of which the truth is known.

A case counts with the logarithm of the probability that its truth is given: the concealed set (a
parameter of the simulator's that is the same as an effect counts as that), nothing, or `unknown`
where no effect is what the simulator lacks: other physics is concealed, or nothing, and without
drives from before the simulator of another make is not the car. A set that the search did not come
to cannot be given, and the case does not count; in `score.tables` it does. Weights are shrunk by a
Gaussian prior on scaled features, as wide as predicts left-out groups best.
"""

import hashlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch
import yaml
from omegaconf import MISSING
from torch import Tensor

from buggy_rl.diagnosis.search.posterior import (
    Calibration,
    FormError,
    Posterior,
    of_case,
    of_hypotheses,
)
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.equivalents import of_same_name
from buggy_rl.proof.ledger import Entry
from buggy_rl.proof.plants.composed import Sort, is_composed

RIDGES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # precisions of the weights' prior that are tried
EARLIER = 3.0  # precision of that prior of earlier ledgers' weights, which predicted best there
# Share of a case that one of an earlier ledger counts as; chosen, see docs/evidence.md, All cases.
COUNTS = 0.1
FOLDS = 8  # groups are left out by as many parts
SHUT = -1e9  # score of a hypothesis that a case does not have


@dataclass(frozen=True)
class CalibrateConfig:
    """Which ledgers the weights are fitted to."""

    ledgers: list[str] = MISSING
    """Files that scripts/develop.py wrote."""
    apply: bool = False
    """Counts what the weights that the package ships give, and fits none."""
    weights: str = ""
    """File of other weights, with `apply=true`: to be counted in their place."""
    without: list[str] = field(default_factory=list)
    """Features that get no weight, to see what they tell; not to be written."""
    counts: float = COUNTS
    """Share of a case that one of an earlier ledger counts as; others are not to be written."""
    write: bool = False
    """Whether the weights replace those that the package ships."""


@dataclass(frozen=True, eq=False)
class FeatureTable:
    """Features of cases, side by side."""

    hypotheses: Tensor
    """[n, H, F]; cases of fewer hypotheses are filled with zeros,"""
    shut: Tensor
    """[n, H + 1] and those have this added to their score."""
    case: Tensor
    """[n, G]"""
    true: Tensor
    """[n, H + 1] hypotheses that are the truth, the last for unknown; none where the search did not
    come to it."""
    later: Tensor
    """[n] whether all features of the case are known; earlier ledgers lack some."""
    names: tuple[Sequence[str], Sequence[str]]

    def __getitem__(self, rows: Tensor) -> "FeatureTable":
        return FeatureTable(
            self.hypotheses[rows],
            self.shut[rows],
            self.case[rows],
            self.true[rows],
            self.later[rows],
            self.names,
        )


def group(case: Case) -> str:
    """What is left out together: a kind of unknown physics, or cases of one pairing."""
    if case.family != "unknown":
        return f"{case.plant}, {case.simulator}, {case.baseline}, {case.seed % 4}"
    [sort] = case.truth
    return Sort.named(sort).where if is_composed(sort) else sort


def feature_table(entries: Sequence[Entry], without: Collection[str] = ()) -> FeatureTable:
    """Table of a ledger's cases, but for some features.

    Raises:
        ValueError: There is no such feature.
    """
    seen = [e.seen for e in entries]
    own, cases = [of_hypotheses(s) for s in seen], [of_case(s) for s in seen]
    missing = {*without} - {*own[0][0], *cases[0]}
    if missing:
        raise ValueError(
            f"no feature {', '.join(sorted(missing))}; there are "
            f"{', '.join(sorted({*own[0][0], *cases[0]}))}"
        )
    own = [[_but(f, without) for f in features] for features in own]
    cases = [_but(f, without) for f in cases]
    names = list(own[0][0]), list(cases[0])
    most = max(map(len, own))
    hypotheses = torch.zeros(len(entries), most, len(names[0]), dtype=torch.float64)
    shut = torch.full((len(entries), most + 1), SHUT, dtype=torch.float64)
    shut[:, -1] = 0.0
    true = torch.zeros(len(entries), most + 1, dtype=torch.bool)
    for row, (entry, features) in enumerate(zip(entries, own, strict=True)):
        hypotheses[row, : len(features)] = torch.tensor([[*f.values()] for f in features]).double()
        shut[row, : len(features)] = 0.0
        for column, h in enumerate(seen[row].fitted):
            effects = tuple(sorted({*map(of_same_name, h.effects)}))
            true[row, column] = effects == entry.case.truth and not entry.case.unknown
        true[row, -1] = entry.case.unknown
    case = torch.tensor([[*c.values()] for c in cases]).double()
    later = torch.tensor([s.null.changed is not None for s in seen])
    return FeatureTable(hypotheses, shut, case, true, later, names)


def _but(features: Mapping[str, float], without: Collection[str]) -> dict[str, float]:
    return {name: value for name, value in features.items() if name not in without}


def weights(of: FeatureTable, ridge: float, counts: float = COUNTS) -> tuple[Tensor, Tensor]:
    """Weights [F] and [G] by penalised maximum likelihood.

    Cases of earlier ledgers lack features. Their weights are the mean of the prior of those of the
    later ones, and their curvature is a part of its precision.

    Args:
        of: Cases.
        ridge: Precision of the prior.
        counts: Share of a case that one of an earlier ledger counts as there.
    """
    none = of.hypotheses.new_zeros(len(of.names[0]) + len(of.names[1]))
    flat = none.new_zeros(len(none), len(none))
    if not bool(of.later.any()) or bool(of.later.all()):
        return _weights(of, ridge, none, flat)
    earlier = of[~of.later]
    mean = torch.cat(_weights(earlier, EARLIER, none, flat))
    return _weights(of[of.later], ridge, mean, counts * _curvature(earlier, mean))


def _weights(
    of: FeatureTable, ridge: float, mean: Tensor, precision: Tensor
) -> tuple[Tensor, Tensor]:
    """Weights by a prior about a mean [F + G], of a precision [F + G, F + G] beside the ridge's."""
    known = of[of.true.any(1)]
    inside = known.shut[:, :-1] == 0
    sd = known.hypotheses[inside].std(0).clamp_min(1e-6)
    spread = known.case.std(0)
    spread = torch.where(spread < 1e-9, torch.ones_like(spread), spread)
    scale = torch.cat([sd, spread])
    scaled = (mean * scale).clone().requires_grad_()
    optimiser = torch.optim.LBFGS([scaled], max_iter=500, line_search_fn="strong_wolfe")

    def closure() -> Tensor:
        optimiser.zero_grad()
        off = scaled / scale - mean
        loss = -_log_likelihood(known, *_split(of, scaled / scale)).sum()
        loss = loss + 0.5 * ridge * (off * scale).square().sum() + 0.5 * off @ precision @ off
        loss.backward()
        return loss

    optimiser.step(closure)
    return _split(of, (scaled / scale).detach())


def _curvature(of: FeatureTable, weights: Tensor) -> Tensor:
    """Second derivative [F + G, F + G] of the negative log likelihood."""
    known = of[of.true.any(1)]

    def loss(at: Tensor) -> Tensor:
        return -_log_likelihood(known, *_split(of, at)).sum()

    return torch.autograd.functional.hessian(loss, weights)


def _split(of: FeatureTable, weights: Tensor) -> tuple[Tensor, Tensor]:
    count = len(of.names[0])
    return weights[:count], weights[count:]


def _log_likelihood(of: FeatureTable, w: Tensor, v: Tensor) -> Tensor:
    """Log probability [n] of each truth."""
    scores = torch.cat([of.hypotheses @ w, (of.case @ v).unsqueeze(1)], 1) + of.shut
    wrong = torch.where(of.true, 0.0, SHUT)
    return torch.logsumexp(torch.log_softmax(scores, 1) + wrong, 1)


def case_folds(entries: Sequence[Entry]) -> Tensor:
    """Part [n] of each case; a group is in one part."""
    names = sorted({group(e.case) for e in entries})
    part = {name: number % FOLDS for number, name in enumerate(names)}
    return torch.tensor([part[group(e.case)] for e in entries])


def left_out(
    entries: Sequence[Entry], ridge: float, without: Collection[str] = (), counts: float = COUNTS
) -> tuple[list[Posterior], float]:
    """Posterior of each case by weights from other groups; mean log probability of truths."""
    of, part = feature_table(entries, without), case_folds(entries)
    found: list[Posterior] = [Posterior({}, 1.0)] * len(entries)
    kept = list(_by_fold(of, part, ridge, counts))
    for out, w, v in kept:
        calibration = _calibration(of[~out], w, v)
        for row in out.nonzero().flatten().tolist():
            found[row] = entries[row].posterior(calibration)
    return found, _predicted(of, kept)


def calibrated(
    entries: Sequence[Entry], without: Collection[str] = (), counts: float = COUNTS
) -> tuple[Calibration, float]:
    """Weights from all cases, and the ridge that predicts left-out groups best."""
    of, part = feature_table(entries, without), case_folds(entries)
    ridge = max(RIDGES, key=lambda r: _predicted(of, _by_fold(of, part, r, counts)))
    return _calibration(of, *weights(of, ridge, counts)), ridge


def _by_fold(
    of: FeatureTable, part: Tensor, ridge: float, counts: float
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Which cases [n] are left out, and the weights of the others."""
    for number in range(FOLDS):
        out = part == number
        yield out, *weights(of[~out], ridge, counts)


def _predicted(of: FeatureTable, kept: Iterable[tuple[Tensor, Tensor, Tensor]]) -> float:
    """Mean log probability of the truths of cases that are left out; of later ledgers' if any."""
    counts = of.true.any(1) & (of.later | ~of.later.any())
    scored = ((of[out & counts], w, v) for out, w, v in kept)
    total = sum(float(_log_likelihood(part, w, v).sum()) for part, w, v in scored)
    return total / max(1, int(counts.sum()))


def _calibration(of: FeatureTable, w: Tensor, v: Tensor) -> Calibration:
    hypothesis, case = (
        {name: float(f"{x:.4g}") for name, x in zip(names, values.tolist(), strict=True)}
        for names, values in zip(of.names, (w, v), strict=True)
    )
    return Calibration(hypothesis, case, cases=len(of.case))


def content(
    calibration: Calibration,
    form: FormError,
    ledgers: Sequence[Path],
    cases: int,
    ridge: float,
    step: FormError | None = None,
) -> str:
    """The calibration as a file, with what it was made from.

    Args:
        calibration: Weights.
        form: Form error of numbers.
        ledgers: Files of the cases,
        cases: and how many.
        ridge: Of the weights.
        step: Form error of step tests; None where no case has any, and that of numbers counts.
    """
    made = {
        "ledgers": {f.name: hashlib.sha256(f.read_bytes()).hexdigest() for f in ledgers},
        "cases": cases,
        "ridge": ridge,
    }
    weights_of = {
        "hypothesis": dict(calibration.hypothesis),
        "unknown": dict(calibration.unknown),
        "form_error": asdict(form),
    }
    if step is not None:
        weights_of["step_error"] = asdict(step)
    head = "# Written by scripts/calibrate.py; not to be edited by hand.\n"
    return head + yaml.safe_dump({"made_from": made, **weights_of}, sort_keys=False)
