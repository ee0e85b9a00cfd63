"""Which causes are worth a fit: all of them at trial sizes, in one batch."""

from dataclasses import replace

import torch
from torch import Tensor

from buggy_rl.estimation.gauss_newton import Fitted, Fitter

SCREENED = 44  # stretches, spread evenly, on which causes are screened
STAMPED = 0.05  # of the clock's typical offset: less is none
FARTHEST = 1.5  # times the way to a trial, along which its promise is looked for


def screened(fitter: Fitter, base: Fitted, keep: int) -> list[Fitted]:
    """The most promising starts: the base and one more cause each, at its best trial size."""
    rows: list[tuple[Fitted, Tensor]] = []
    for name in fitter.library.causes:
        if name in base.causes:
            continue
        begin = fitter.start((*base.causes, name))
        kept, clock = base.place[:-1], base.place[-1:]
        for trial in fitter.library.trials(name, fitter.cut):
            # With the base's clock, and with a right one: without the cause, the clock may have
            # taken over a delay that is the cause's.
            for stamp in (clock, 0 * clock) if abs(float(clock)) > STAMPED else (clock,):
                place = [kept, torch.tensor(trial, dtype=torch.float64), stamp]
                rows.append((begin, torch.cat(place)))
    thin, few = _thinned(fitter, base)
    best: dict[str, tuple[float, Fitted]] = {}
    for (fitted, place), white in zip(rows, thin.evaluate(rows), strict=True):
        trial = Fitted(fitted.causes, fitted.unknowns, place, white)
        hope = promise(fitter, few, trial)
        name = fitted.causes[-1]
        if name not in best or hope < best[name][0]:
            best[name] = hope, trial
    ranked = sorted(best.values(), key=lambda item: item[0])
    return [trial for _, trial in ranked[:keep]]


def promise(fitter: Fitter, base: Fitted, trial: Fitted) -> float:
    """Loss [nats] at the best point between the base and a trial, along a straight line.

    Gaps move by t (w_trial - w_base) with t in 0..1.5, projected off what the base's own
    parameters could have absorbed.
    """
    likely, temper = fitter.likelihood, fitter.temper
    move = trial.white - base.white  # (N, D)
    weight = likely.weight(base.square, temper).unsqueeze(-1)
    if base.slopes is not None:
        slopes = base.slopes  # (N, D, P)
        normal = torch.einsum("ndp,ndq,ne->pq", slopes, slopes, weight)
        normal = normal + 1e-9 * torch.eye(len(normal), dtype=normal.dtype)
        along = torch.einsum("ndp,nd,ne->p", slopes, move, weight)
        move = move - slopes @ torch.linalg.solve(normal, along)
    curve = float((weight * move.square()).sum())
    share = -float((weight * move * base.white).sum()) / max(curve, 1e-12)
    share = min(max(share, 0.0), FARTHEST)
    square = (base.white + share * move).square().sum(-1)
    direct = likely.loss(trial.square, temper).sum()
    line = likely.loss(square, temper).sum()
    return float(torch.minimum(direct, line))


def _thinned(fitter: Fitter, base: Fitted) -> tuple[Fitter, Fitted]:
    """A fitter to `SCREENED` of the stretches at most, and the base on those."""
    count = len(fitter.cut)
    rows = torch.linspace(0, count - 1, min(count, SCREENED)).round().long()
    cut, likely = fitter.cut[rows], fitter.likelihood[rows]
    thin = Fitter(fitter.player, cut, likely, fitter.library, fitter.temper)
    slopes = None if base.slopes is None else base.slopes[rows]
    return thin, replace(base, white=base.white[rows], slopes=slopes)
