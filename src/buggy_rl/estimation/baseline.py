"""A simulator's standing faults: closed on baseline drives first, so that changes stand out.

What the correction cannot close either enters the likelihood of the drives with the change.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl import keys
from buggy_rl.effects.motion.base import Motion
from buggy_rl.effects.residual import ResidualAcceleration, ResidualNetwork, residual_inputs
from buggy_rl.estimation.cross_validation import BLOCK, blocks
from buggy_rl.estimation.misfit import misfit
from buggy_rl.estimation.noise_model import HEAVY, Likelihood, likelihood
from buggy_rl.estimation.rollout import Player, explained
from buggy_rl.estimation.segments import WARM_UP, Stretches, sensor_noise, start_noise
from buggy_rl.vehicle import VehicleDimensions, shift_velocity

SHRUNK = (0.1, 0.2, 0.4, 0.7)  # shares of the standing covariance taken from its diagonal: tried
FILE = "correction.pt"  # a correction's network, beside repaired.yaml
FOLDS = 3  # parts of the drives, each foretold from the others
STRENGTHS = (0.0, 0.5, 1.0)
SPIN = 25.0  # times the noise's variance, as which a stretch counts at most
BOUND = 3.0  # root mean squares of the target, beyond which no correction goes
SPANS = (1, 20)  # rows over which accelerations are compared
STEPS, BATCH = 500, 24  # updates, and stretches in each
LEARNING_RATE, DECAY = 5e-3, 1e-2


def standing_misfit(gap: Tensor, sensed: Tensor, shrunk: float) -> Tensor:
    """Covariance of what a simulator gets wrong where nothing has changed.

    S = mean of w e e^T over the stretches, w = min(1, SPIN D / |W e|^2) so that spins count little;
    shrunk to its diagonal; without the sensor's part B: C = F max(F^-1 S F^-T - 1, 0) F^T with
    F F^T = B, the maximum taken of the eigenvalues.

    Args:
        gap: [N, K, 6] of baseline stretches that nothing was trained on.
        sensed: [D, D] covariance B of the sensor's noise and of the error of the start.
        shrunk: Share of S that is taken from its diagonal.

    Returns:
        [D, D] float64, D = K * 6, as `likelihood` takes it for `extra`.
    """
    flat = _flat(gap)
    factor = torch.linalg.cholesky(sensed)
    white = torch.linalg.solve_triangular(factor, flat.mT, upper=False).mT  # (N, D)
    weight = (SPIN / white.square().mean(-1)).clamp_max(1.0)
    square = torch.einsum("ni,nj,n->ij", white, white, weight) / len(white)
    rounder = torch.lerp(square, torch.diag(square.diagonal()), shrunk)
    values, vectors = torch.linalg.eigh(rounder)
    over = factor @ vectors
    return (over * (values - 1).clamp_min(0.0)) @ over.mT


def best_shrinkage(gap: Tensor, sensed: Tensor, fold: Tensor) -> float:
    """The one of `SHRUNK` under which each third of the gaps is likeliest, weighed by the others.

    A stretch has as many numbers as there are stretches: their covariance as it is would say that
    what these did not show cannot be.
    """
    flat, heavy = _flat(gap), HEAVY * sensed.shape[-1]
    worse = dict.fromkeys(SHRUNK, 0.0)
    for shrunk in SHRUNK:
        for aside in fold.unique():
            rows = fold == aside
            factor = torch.linalg.cholesky(sensed + standing_misfit(gap[~rows], sensed, shrunk))
            white = torch.linalg.solve_triangular(factor, flat[rows].mT, upper=False)
            lost = 0.5 * heavy * torch.log1p(white.square().sum(0) / heavy)
            worse[shrunk] += float((lost + factor.diagonal().log().sum()).sum())
    return min(SHRUNK, key=lambda shrunk: worse[shrunk])


def _flat(gap: Tensor) -> Tensor:
    return gap.flatten(1).double().nan_to_num(1e3, 1e3, -1e3).clamp(-1e3, 1e3)


def sensed_covariance(player: Player, cut: Stretches) -> Tensor:
    """[D, D] mean over stretches of the sensor's noise and of the error of the start."""
    noise = sensor_noise(cut)
    shift = torch.cat([torch.zeros(1, 6), torch.diag(start_noise(cut))])
    gap = player.play(cut, {}, shift=shift).double()  # (7, N, K, 6)
    slopes = (gap[1:] - gap[:1]).flatten(2).movedim(0, -1).nan_to_num(0.0).clamp(-10, 10)
    spread = (slopes @ slopes.mT).mean(0)
    return spread + torch.diag(noise.double().square().repeat(gap.shape[2]))


@dataclass(frozen=True)
class Correction:
    """What a simulator gets wrong on its baseline, as far as a network can say it."""

    effect: ResidualAcceleration | None
    """At its strength; None where it did not help on what was held out."""
    covariance: Tensor
    """[D, D] of what remains wrong, for `likelihood`."""
    before: float
    """Misfit of held-out baseline stretches without it."""
    after: float
    """Misfit with it."""
    held_out: Tensor
    """[N] |W e|^2 / D of the baseline stretches, network and covariance from the other thirds."""
    weighed: Likelihood
    """Of the baseline stretches, the covariance from the other thirds."""

    @property
    def note(self) -> str:
        """What was done about the baseline, in plain words."""
        was = f"on the baseline drives the simulator is off by {self.before:.2g} times the noise"
        if self.effect is None:
            return f"{was}; no correction that was learned there helps: so much is its own"
        return f"{was}, with a correction learned there by {self.after:.2g}: so much is its own"

    def player(self, player: Player) -> Player:
        """Plays into the corrected simulator."""
        return player if self.effect is None else replace(player, standing=(self.effect,))


def correct(
    player: Player, cut: Stretches, seed: int = 0, progress: Callable[[str], None] = lambda _: None
) -> Correction:
    """Closes a simulator's standing faults on the drives on which it counts as right.

    A network learns the acceleration that the engine's steps lack. Its strength is the one of
    `STRENGTHS` with which rollouts come closest, each third of the drives' blocks foretold by a
    network that was trained on the others; what they still get wrong becomes the covariance. The
    network that is kept is trained on all.

    Args:
        player: Plays into the simulator.
        cut: Baseline stretches.
        seed: Of the networks' starts.
        progress: Told in plain words what is being done.

    Raises:
        ValueError: The drives are too short to hold anything out.
    """
    fold = blocks(cut) % FOLDS
    if int(fold.max()) < FOLDS - 1:
        raise ValueError(
            f"the baseline drives have fewer than {FOLDS} blocks of {BLOCK:g} s: nothing is left "
            f"to judge a correction on; record at least {FOLDS * BLOCK:g} s"
        )
    progress("learning what the simulator gets wrong on the baseline")
    inputs, lacking = lacking_acceleration(player, cut)
    gaps: dict[float, list[Tensor]] = {strength: [] for strength in STRENGTHS}
    for aside in range(FOLDS):
        rest = fold != aside
        network = trained(inputs[rest], lacking[rest], seed)
        for strength in STRENGTHS:
            effect = ResidualAcceleration(model=network, strength=strength)
            held_out = replace(player, standing=(effect,)).play(cut[~rest], {})[0]
            gaps[strength].append(held_out)
    order = torch.cat([(fold == aside).nonzero().squeeze(-1) for aside in range(FOLDS)])
    weighed = likelihood(player, cut)[order]
    square = {s: weighed.white(torch.cat(g)[None])[0].square().sum(-1) for s, g in gaps.items()}
    best = min(STRENGTHS, key=lambda strength: float(weighed.loss(square[strength]).sum()))
    effect = None
    if best:
        effect = ResidualAcceleration(model=trained(inputs, lacking, seed), strength=best)
    gap = torch.cat(gaps[best])[order.argsort()]
    sensed = sensed_covariance(player, cut)
    shrunk = best_shrinkage(gap, sensed, fold)
    crossed = _crossed(player, cut, gap, sensed, shrunk, fold)
    return Correction(
        effect=effect,
        covariance=standing_misfit(gap, sensed, shrunk),
        before=misfit(square[0.0] / weighed.readings),
        after=misfit(square[best] / weighed.readings),
        held_out=crossed.white(gap[None])[0].square().sum(-1) / crossed.readings,
        weighed=crossed,
    )


def _crossed(
    player: Player, cut: Stretches, gap: Tensor, sensed: Tensor, shrunk: float, fold: Tensor
) -> Likelihood:
    """Weighs each third of the stretches by what the others get wrong."""
    noise, whitening = sensor_noise(cut), None
    for aside in fold.unique():
        rows = fold == aside
        extra = standing_misfit(gap[~rows], sensed, shrunk)
        part = likelihood(player, cut[rows], extra=extra).whitening
        whitening = part.new_zeros(len(gap), *part.shape[1:]) if whitening is None else whitening
        whitening[rows] = part
    assert whitening is not None
    return Likelihood(whitening, noise)


@torch.no_grad()
def lacking_acceleration(player: Player, cut: Stretches) -> tuple[Tensor, Tensor]:
    """What each step of the engine lacks to end where the measured motion went.

    The measured motion is imposed at every row, so hidden states are what they would be on the
    drive; a = (v_measured - v_engine) / dt at the centre of gravity.

    Returns:
        The network's inputs [N, H, 8] and the acceleration [N, H, 3] of the rows of a rollout.
    """
    env, _ = explained(player.make(len(cut)), {}, {}, player.standing)
    pose, velocity = cut.smooth_pose, cut.smooth_velocity
    arm = VehicleDimensions().sensor_to_cg
    start = TensorDict({keys.POSE: pose[:, 0], keys.VELOCITY: velocity[:, 0]}, [len(cut)])
    state = env.reset(start)
    inputs, lacking = [], []
    for row in range(pose.shape[1] - 1):
        state[keys.POSE], state[keys.VELOCITY] = pose[:, row], velocity[:, row]
        state[keys.ACTION] = cut.action[:, row]
        state = env.step(state)["next"]
        if row < WARM_UP:
            continue
        both = torch.stack([velocity[:, row], velocity[:, row + 1], state[keys.VELOCITY]])
        before, wanted, after = shift_velocity(both, -arm).unbind(0)
        motion = Motion(pose[:, row], before, after, cut.action[:, row].clamp(-1, 1), cut.dt)
        inputs.append(residual_inputs(motion))
        lacking.append((wanted - after) / cut.dt)
    return torch.stack(inputs, 1), torch.stack(lacking, 1)


def trained(inputs: Tensor, lacking: Tensor, seed: int) -> ResidualNetwork:
    """A network fitted to accelerations row by row and to their means over `SPANS` rows.

    The means bring out what is small but lasts, which decides where a rollout ends; row by row it
    drowns in the noise of a derivative.

    Args:
        inputs: [N, H, 8].
        lacking: [N, H, 3].
        seed: Same seed, same network.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = ResidualNetwork()
        network.mean.copy_(inputs.flatten(0, 1).mean(0))
        network.scale.copy_(inputs.flatten(0, 1).std(0).clamp_min(1e-3))
        network.bound.copy_(BOUND * lacking.square().mean((0, 1)).sqrt().clamp_min(1e-3))
        size = [_spans(lacking, span).square().mean((0, 1)).clamp_min(1e-6) for span in SPANS]
        optimiser = torch.optim.AdamW(network.parameters(), LEARNING_RATE, weight_decay=DECAY)
        for _ in range(STEPS):
            rows = torch.randperm(len(inputs))[:BATCH]
            error = network(inputs[rows]) - lacking[rows]
            parts = [
                (_spans(error, n).square() / s).mean() for n, s in zip(SPANS, size, strict=True)
            ]
            optimiser.zero_grad()
            torch.stack(parts).sum().backward()
            optimiser.step()
    return network.eval().requires_grad_(False)


def _spans(signal: Tensor, rows: int) -> Tensor:
    """Means [N, H // rows, C] of a signal [N, H, C] over spans of rows; the rest is left out."""
    count = signal.shape[1] // rows
    return signal[:, : count * rows].unflatten(1, (count, rows)).mean(2)
