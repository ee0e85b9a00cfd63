"""Which manoeuvre to drive next, so that what the drives leave open is decided."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl import keys
from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.manoeuvres import MANOEUVRES
from buggy_rl.estimation.gauss_newton import Fitter
from buggy_rl.estimation.noise_model import likelihood
from buggy_rl.estimation.rollout import explained, reading
from buggy_rl.estimation.segments import Stretches, stretches
from buggy_rl.recordings import Recording

TIMES = 6  # as often as a manoeuvre is expected to be driven, each time facing another way,
HEADED = 3  # of which as many ways are looked at
ENOUGH = 10.0  # nats by which an explanation is told from another,
PLENTY = 100.0  # and beyond which more of them decide no better
BEYOND = (1.5, 1.2)  # times the speed, and the leaning, of what was driven: so far one trusts
ALMOST = 0.95  # a simulator; of the stretches
LEAST = 1e-9  # variance of a number in units of its size, at least


def suggestions(fitter: Fitter, best: Candidate, rivals: Sequence[Candidate]) -> list[str]:
    """What to drive next, a line each, until the best is told from every rival that can be.

    Args:
        fitter: To what was driven.
        best: The explanation that is taken for the truth.
        rivals: Others that the drives do not tell from it.
    """
    if not rivals:
        return []
    nats, size = decided(fitter, best, rivals)
    left, found = list(range(len(rivals))), []
    while left:
        # Where all decide, by what shows most in a stretch, for that may drown in what remains.
        shows = size[left].min(0).values
        chosen = int(((nats[left] / PLENTY).clamp_max(1.0).sum(0) + shows / (1 + shows)).argmax())
        told = [r for r in left if nats[r, chosen] >= ENOUGH]
        if not told and (found or not bool(nats.any())):
            break  # nothing tells what is left, or the simulator was taught no manoeuvre at all
        told = told or [max(left, key=lambda r: float(nats[r, chosen]))]
        names = " and from ".join("+".join(rivals[r].causes) or "nothing" for r in told)
        by = min(float(size[r, chosen]) for r in told)
        found.append(
            f"{MANOEUVRES[chosen].words} (tells {'+'.join(best.causes) or 'nothing'} from "
            f"{names}, by {by:.2g} times the noise)"
        )
        left = [r for r in left if r not in told]
    return found


def decided(fitter: Fitter, best: Candidate, rivals: Sequence[Candidate]) -> tuple[Tensor, Tensor]:
    """How well each manoeuvre would tell an explanation from its rivals.

    T-optimality (Atkinson, Fedorov 1975): the best is taken for the truth, and a rival may take
    other numbers as far as what was driven lets it. To first order, with the gap d between both
    on the stretches of a manoeuvre, the rival's slopes J there and the precision P of its numbers,
    it is worse by (d^T d - d^T J (P + J^T J)^-1 J^T d) / 2. Stretches in which the car is much
    faster than it was driven, or leans more, decide nothing: there the simulator may be wrong in
    other ways. Nor do those in which a learned one says that it was never taught what is asked.

    Args:
        fitter: To what was driven.
        best: That is taken for the truth.
        rivals: R others.

    Returns:
        nats [R, M] of each of M manoeuvres, driven `TIMES` times, and the gap that they stand for,
        a root mean square in units of the noise.
    """
    recordings, outside = _driven(fitter, best)
    cut = stretches(recordings, fitter.cut.horizon * fitter.cut.dt, 1.0)
    places = cut.row.unsqueeze(-1) + torch.arange(cut.pose.shape[1])  # (N, L)
    known = ~outside[cut.drive.unsqueeze(-1), places].any(-1)
    for most, asked, beyond in zip(_pace(fitter.cut), _pace(cut), BEYOND, strict=True):
        known &= asked <= beyond * most.quantile(ALMOST)
    settings = fitter.library.settings([(best.fitted.unknowns, best.fitted.place)])
    extra = fitter.likelihood.extra
    weighed = likelihood(fitter.player, cut, settings, extra, fitter.cut)
    there = Fitter(fitter.player, cut, weighed, fitter.library, max(1.0, best.typical))
    fitted = [candidate.fitted for candidate in (best, *rivals)]
    white = there.evaluate([(f, f.place) for f in fitted])
    others = [replace(f, white=w, slopes=None) for f, w in zip(fitted, white, strict=True)][1:]
    there.differentiate(others)
    nats = torch.zeros(len(rivals), len(MANOEUVRES), dtype=torch.float64)
    size = torch.zeros_like(nats)
    for index, (rival, other) in enumerate(zip(rivals, others, strict=True)):
        assert other.slopes is not None
        own = torch.eye(len(other.place), dtype=torch.float64)
        precision = torch.linalg.inv(rival.evidence.covariance + LEAST * own)
        gap = other.white - white[0]
        for manoeuvre in range(len(MANOEUVRES)):
            rows = (cut.drive // HEADED == manoeuvre) & known
            if not bool(rows.any()):
                continue
            d, slopes = gap[rows].flatten(), other.slopes[rows].flatten(0, 1)  # [n D], [n D, P]
            weight = TIMES / HEADED / there.temper
            score = weight * slopes.T @ d
            refitted = torch.linalg.solve(precision + weight * slopes.T @ slopes, score)
            rest = (weight * d.square().sum() - score @ refitted).nan_to_num(0.0).clamp_min(0.0)
            nats[index, manoeuvre] = 0.5 * rest
            size[index, manoeuvre] = (rest / weight / len(d)).sqrt()
    return nats, size


def _pace(cut: Stretches) -> tuple[Tensor, Tensor]:
    """Highest speed [m/s] and sideways acceleration [m/s^2] of stretches, [N] each."""
    vx, yaw_rate = cut.smooth_velocity[..., 0], cut.smooth_velocity[..., 2]
    return vx.abs().amax(-1), (vx * yaw_rate).abs().amax(-1)


@torch.no_grad()
def _driven(fitter: Fitter, truth: Candidate) -> tuple[list[Recording], Tensor]:
    """What the sensor would show of all manoeuvres, `HEADED` of each, one after the other.

    Returns:
        Drives, and which of their rows [drives, T] the simulator calls out of its range.
    """
    dt = fitter.cut.dt
    actions = [m.actions(dt) for m in MANOEUVRES for _ in range(HEADED)]
    longest, cars = max(map(len, actions)), len(actions)
    idle = torch.tensor([-1.0, 0.0])
    told = torch.stack([torch.cat([a, idle.expand(longest - len(a), 2)]) for a in actions])
    rows = [(truth.fitted.unknowns, truth.fitted.place)]
    effects, parameters, _ = fitter.library.settings(rows)
    each = {e: {p: v.expand(cars) for p, v in ps.items()} for e, ps in effects.items()}
    own = {name: v.expand(cars) for name, v in parameters.items()}
    player = fitter.player
    env, _ = explained(player.make(cars), each, own, player.standing, player.options)
    start = TensorDict(
        {keys.POSE: torch.zeros(cars, 3), keys.VELOCITY: torch.zeros(cars, 3)}, [cars]
    )
    start[keys.POSE][:, 2] = 2 * torch.pi / HEADED * (torch.arange(cars) % HEADED)
    state, shown, outside = env.reset(start), [], []
    inside = torch.zeros(cars, 1, dtype=torch.bool)
    for action in told.unbind(1):
        shown.append(reading(state))
        outside.append(state.get(keys.OUT_OF_RANGE, inside).flatten())
        state[keys.ACTION] = action
        state = env.step(state)["next"]
    read = torch.stack(shown, 1)  # (cars, T, 6)
    recordings = [
        Recording(f"manoeuvre_{car}", _as_recorded(read[car, : len(a)], a, dt), dt)
        for car, a in enumerate(actions)
    ]
    return recordings, torch.stack(outside, 1)


def _as_recorded(shown: Tensor, action: Tensor, dt: float) -> TensorDict:
    """A drive [T] of what was shown [T, 6] under actions [T, 2]."""
    time = dt * torch.arange(len(shown), dtype=torch.float64)
    return TensorDict(
        {
            keys.TIME: time.unsqueeze(-1),
            keys.POSE: shown[:, :3].clone(),
            keys.VELOCITY: shown[:, 3:].clone(),
            keys.ACTION: action,
            keys.SEGMENT: torch.zeros(len(shown), dtype=torch.long),
        },
        [len(shown)],
    )
