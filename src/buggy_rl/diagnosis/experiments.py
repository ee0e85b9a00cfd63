"""Which manoeuvre to drive next, so that hypotheses the recordings leave open are decided."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl import keys
from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.manoeuvres import MANOEUVRES
from buggy_rl.estimation.gauss_newton import Fit, Problem, linearised
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import sensed
from buggy_rl.estimation.segments import Segments, cut_segments
from buggy_rl.longitudinal import declared_by
from buggy_rl.recordings import Recording

TIMES = 6  # as often as a manoeuvre is expected to be driven, each time facing another way,
HEADINGS = 3  # of which as many are simulated
PLENTY = 100.0  # [nats] beyond which more of them decide no better
# A simulator is trusted up to so many times the 95 % quantile of the driven speed and lateral
# acceleration.
TRUSTED, ALMOST = (1.5, 1.2), 0.95
LEAST = 1e-9  # [prior scales^2] variance of a parameter, at least


def suggestions(
    problem: Problem, best: Candidate, others: Sequence[Candidate], least: float
) -> list[str]:
    """What to drive next, a line each, until the best is told from every alternative that can be.

    Args:
        problem: What was driven.
        best: The hypothesis that is taken for the truth.
        others: Alternatives that the recordings do not tell from it.
        least: Nats by which a manoeuvre decides.
    """
    if not others:
        return []
    nats, size = decided(problem, best, others)
    left, found = list(range(len(others))), []
    while left:
        # Where all decide, by what shows most in a segment, for that may drown in what remains.
        shows = size[left].min(0).values
        chosen = int(((nats[left] / PLENTY).clamp_max(1.0).sum(0) + shows / (1 + shows)).argmax())
        told = [r for r in left if nats[r, chosen] >= least]
        if not told and (found or not bool(nats.any())):
            break  # nothing tells what is left, or the simulator was taught no manoeuvre at all
        told = told or [max(left, key=lambda r: float(nats[r, chosen]))]
        names = " and from ".join("+".join(others[r].effects) or "nothing" for r in told)
        by = min(float(size[r, chosen]) for r in told)
        found.append(
            f"{MANOEUVRES[chosen].words} (tells {'+'.join(best.effects) or 'nothing'} from "
            f"{names}, by {by:.2g} times the noise)"
        )
        left = [r for r in left if r not in told]
    return found


def decided(
    problem: Problem, best: Candidate, others: Sequence[Candidate]
) -> tuple[Tensor, Tensor]:
    """How well each manoeuvre would tell a hypothesis from its alternatives.

    T-optimality (Atkinson, Fedorov 1975): the best is taken for the truth, and an alternative may
    take other numbers as far as what was driven lets it. To first order, with the residual d
    between both on the segments of a manoeuvre, the alternative's derivatives J there and the
    precision P of its numbers, it is worse by (d^T d - d^T J (P + J^T J)^-1 J^T d) / 2. Segments
    much faster than what was driven decide nothing: there the simulator may be wrong in other
    ways. Nor do those that a learned simulator reports as outside its training range.

    Args:
        problem: What was driven.
        best: That is taken for the truth.
        others: R alternatives.

    Returns:
        nats [R, M] of each of M manoeuvres, driven `TIMES` times, and the residual that they stand
        for, a root mean square in noise standard deviations.
    """
    recordings, outside = _simulated(problem, best)
    segments = cut_segments(recordings, problem.segments.horizon * problem.segments.dt, 1.0)
    trusted = _trusted(problem.segments, segments, outside)
    settings = problem.library.settings([(best.fit, best.fit.vector)])
    noise = noise_model(
        problem.simulation, segments, settings, problem.noise.extra, problem.segments
    )
    there = replace(problem, segments=segments, noise=noise, dispersion=max(1.0, best.typical))
    truth, *rolled_out = there.rolled_out([candidate.fit for candidate in (best, *others)])
    nats = torch.zeros(len(others), len(MANOEUVRES), dtype=torch.float64)
    size = torch.zeros_like(nats)
    for index, (other, fit) in enumerate(zip(others, linearised(there, rolled_out), strict=True)):
        own = torch.eye(len(fit.vector), dtype=torch.float64)
        precision = torch.linalg.inv(other.cross_validated.covariance + LEAST * own)
        for manoeuvre in range(len(MANOEUVRES)):
            rows = (segments.recording // HEADINGS == manoeuvre) & trusted
            if bool(rows.any()):
                weight = TIMES / HEADINGS / there.dispersion
                told = _told_apart(truth, fit, rows, precision, weight)
                nats[index, manoeuvre], size[index, manoeuvre] = told
    return nats, size


def _told_apart(
    truth: Fit, fit: Fit, rows: Tensor, precision: Tensor, weight: float
) -> tuple[Tensor, Tensor]:
    """Nats and residual by which a hypothesis, fitted anew, is worse on some segments."""
    assert fit.jacobian is not None
    d = (fit.whitened - truth.whitened)[rows].flatten()  # (n D,)
    jacobian = fit.jacobian[rows].flatten(0, 1)  # (n D, P)
    score = weight * jacobian.T @ d
    refitted = torch.linalg.solve(precision + weight * jacobian.T @ jacobian, score)
    rest = (weight * d.square().sum() - score @ refitted).nan_to_num(0.0).clamp_min(0.0)
    return 0.5 * rest, (rest / weight / len(d)).sqrt()


def _trusted(driven: Segments, segments: Segments, outside: Tensor) -> Tensor:
    """Which segments [N] of manoeuvres a simulator is trusted in."""
    rows = segments.row.unsqueeze(-1) + torch.arange(segments.pose.shape[1])  # (N, L)
    trusted = ~outside[segments.recording.unsqueeze(-1), rows].any(-1)
    for most, asked, beyond in zip(_pace(driven), _pace(segments), TRUSTED, strict=True):
        trusted &= asked <= beyond * most.quantile(ALMOST)
    return trusted


def _pace(segments: Segments) -> tuple[Tensor, Tensor]:
    """Highest speed [m/s] and lateral acceleration [m/s^2] of segments, [N] each."""
    vx, yaw_rate = segments.smooth_velocity[..., 0], segments.smooth_velocity[..., 2]
    return vx.abs().amax(-1), (vx * yaw_rate).abs().amax(-1)


def _simulated(problem: Problem, truth: Candidate) -> tuple[list[Recording], Tensor]:
    """What the sensor would show of all manoeuvres, `HEADINGS` of each, one after the other.

    Returns:
        Recordings, and which of their rows [recordings, T] the simulator calls out of its range.
    """
    dt = problem.segments.dt
    rest = declared_by(problem.simulation.make(1)).rest
    actions = [m.actions(dt, rest) for m in MANOEUVRES for _ in range(HEADINGS)]
    longest, count = max(map(len, actions)), len(actions)
    idle = torch.tensor([rest, 0.0])
    padded = torch.stack([torch.cat([a, idle.expand(longest - len(a), 2)]) for a in actions])
    settings = problem.library.settings([(truth.fit, truth.fit.vector)])
    start = TensorDict(
        {keys.POSE: torch.zeros(count, 3), keys.VELOCITY: torch.zeros(count, 3)}, [count]
    )
    start[keys.POSE][:, 2] = 2 * torch.pi / HEADINGS * (torch.arange(count) % HEADINGS)
    shown, outside = [], []
    inside = torch.zeros(count, 1, dtype=torch.bool)
    for state in problem.simulation.drive(padded, settings, start):
        shown.append(sensed(state))
        outside.append(state.get(keys.OUT_OF_RANGE, inside).flatten())
    read = torch.stack(shown, 1)  # (count, T, 6)
    recordings = [
        Recording(f"manoeuvre_{index}", _as_recorded(read[index, : len(a)], a, dt), dt)
        for index, a in enumerate(actions)
    ]
    return recordings, torch.stack(outside, 1)


def _as_recorded(shown: Tensor, action: Tensor, dt: float) -> TensorDict:
    """A recording [T] of what was shown [T, 6] under actions [T, 2]."""
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
