"""What a simulator gets wrong where it counts as right: closed on baseline recordings first.

A residual network closes what it can; what it cannot enters the noise model as a covariance.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from buggy_rl.core.vehicle import VehicleDimensions, shift_velocity
from buggy_rl.effects.motion.base import Motion
from buggy_rl.effects.residual import ResidualAcceleration, residual_inputs
from buggy_rl.effects.residual_models import ResidualNetwork
from buggy_rl.estimation.evidence import BLOCK, blocks, misfit
from buggy_rl.estimation.noise_model import (
    FAR,
    HEAVY,
    NoiseModel,
    noise_model,
    sensor_noise,
    start_noise,
    start_sensitivity,
)
from buggy_rl.estimation.rollout import AS_GIVEN, ParameterSets, Simulation
from buggy_rl.estimation.segments import Segments

BOUND = 3.0  # [root mean squares of the target] beyond which no correction goes
SPANS = (1, 20)  # [rows] over which accelerations are compared
STEPS, BATCH = 500, 24  # updates, and segments in each
LEARNING_RATE, DECAY = 5e-3, 1e-2


@torch.no_grad()
def lacking_acceleration(
    simulation: Simulation, segments: Segments, settings: ParameterSets = AS_GIVEN
) -> tuple[Tensor, Tensor]:
    """What each step of the engine lacks to end where the measured motion went.

    a = (v_measured - v_engine) / dt at the centre of gravity, the measured motion imposed at every
    row so that latent states are what they would be.

    Args:
        simulation: Of the simulator.
        segments: N of them.
        settings: One parameter set, in place meanwhile.

    Returns:
        The network's inputs [N, H, 8] and the acceleration [N, H, 3].
    """
    arm = VehicleDimensions().sensor_to_cg
    dt, inputs, lacking = segments.dt, [], []
    for row, imposed, after in simulation.single_steps(segments, settings):
        moving = torch.cat([imposed[..., 3:], after[None, :, 3:]])
        before, wanted, reached = shift_velocity(moving, -arm).unbind(0)
        action = segments.action[:, row].clamp(-1, 1)
        motion = Motion(imposed[0, :, :3], before, reached, action, dt)
        inputs.append(residual_inputs(motion))
        lacking.append((wanted - reached) / dt)
    return torch.stack(inputs, 1), torch.stack(lacking, 1)


def trained(inputs: Tensor, lacking: Tensor, seed: int) -> ResidualNetwork:
    """A network fitted to accelerations row by row and to their means over `SPANS` rows.

    The means bring out what is small but lasts, which decides where a rollout ends; row by row the
    noise of a derivative hides it.

    Args:
        inputs: [N, H, 8].
        lacking: [N, H, 3].
        seed: Same seed, same network.

    Returns:
        Goes on outside these inputs' range as at its edge.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = ResidualNetwork()
        network.mean.copy_(inputs.flatten(0, 1).mean(0))
        network.scale.copy_(inputs.flatten(0, 1).std(0).clamp_min(1e-3))
        network.bound.copy_(BOUND * lacking.square().mean((0, 1)).sqrt().clamp_min(1e-3))
        size = [span_means(lacking, span).square().mean((0, 1)).clamp_min(1e-6) for span in SPANS]
        optimiser = torch.optim.AdamW(network.parameters(), LEARNING_RATE, weight_decay=DECAY)
        for _ in range(STEPS):
            rows = torch.randperm(len(inputs))[:BATCH]
            error = network(inputs[rows]) - lacking[rows]
            parts = [
                (span_means(error, n).square() / s).mean() for n, s in zip(SPANS, size, strict=True)
            ]
            optimiser.zero_grad()
            torch.stack(parts).sum().backward()
            optimiser.step()
    return network.eval().requires_grad_(False)


def span_means(signal: Tensor, rows: int) -> Tensor:
    """Means [N, B, C] of a signal [N, H, C] over spans of rows, at most H; the rest is left out."""
    rows = min(rows, signal.shape[1])
    count = signal.shape[1] // rows
    return signal[:, : count * rows].unflatten(1, (count, rows)).mean(2)


SHRINKAGES = (0.1, 0.2, 0.4, 0.7)  # [-] shares of the covariance taken from its diagonal: tried
FILE = "correction.pt"  # a correction's network, beside repaired.yaml
FOLDS = 3  # parts of the recordings, each predicted from the others
STRENGTHS = (0.0, 0.5, 1.0)  # [-] of a correction: tried
SPIN = 25.0  # [noise variances] as which a segment counts at most


def standing_covariance(residuals: Tensor, sensed: Tensor, shrinkage: float) -> Tensor:
    """Covariance of what a simulator gets wrong where nothing has changed.

    S = mean of w e e^T over the segments, w = min(1, SPIN D / |W e|^2) so that spins count little;
    shrunk to its diagonal; without the sensor's part B: C = F max(F^-1 S F^-T - 1, 0) F^T with
    F F^T = B, the maximum taken of the eigenvalues.

    Args:
        residuals: [N, K, 6] of baseline segments that nothing was trained on.
        sensed: [D, D] covariance B of the sensor's noise and of the start error.
        shrinkage: Share of S that is taken from its diagonal.

    Returns:
        [D, D] float64, D = K * 6, as `noise_model` takes it for `extra`.
    """
    flat = _flat(residuals)
    factor = torch.linalg.cholesky(sensed)
    whitened = torch.linalg.solve_triangular(factor, flat.mT, upper=False).mT  # (N, D)
    weight = (SPIN / whitened.square().mean(-1)).clamp_max(1.0)
    square = torch.einsum("ni,nj,n->ij", whitened, whitened, weight) / len(whitened)
    shrunk = torch.lerp(square, torch.diag(square.diagonal()), shrinkage)
    values, vectors = torch.linalg.eigh(shrunk)
    over = factor @ vectors
    return (over * (values - 1).clamp_min(0.0)) @ over.mT


def best_shrinkage(residuals: Tensor, sensed: Tensor, fold: Tensor) -> float:
    """Value of `SHRINKAGES` under which each fold [N] is likeliest, given the others.

    A segment has as many numbers as there are segments: their sample covariance is singular.
    """
    flat, heavy = _flat(residuals), HEAVY * sensed.shape[-1]
    worse = dict.fromkeys(SHRINKAGES, 0.0)
    for shrinkage in SHRINKAGES:
        for aside in fold.unique():
            rows = fold == aside
            standing = standing_covariance(residuals[~rows], sensed, shrinkage)
            factor = torch.linalg.cholesky(sensed + standing)
            whitened = torch.linalg.solve_triangular(factor, flat[rows].mT, upper=False)
            lost = 0.5 * heavy * torch.log1p(whitened.square().sum(0) / heavy)
            worse[shrinkage] += float((lost + factor.diagonal().log().sum()).sum())
    return min(SHRINKAGES, key=lambda shrinkage: worse[shrinkage])


def _flat(residuals: Tensor) -> Tensor:
    return residuals.flatten(1).double().nan_to_num(FAR, FAR, -FAR).clamp(-FAR, FAR)


def sensed_covariance(simulation: Simulation, segments: Segments) -> Tensor:
    """[D, D] mean over segments of the sensor's noise and of the propagated start error."""
    slopes, about = start_sensitivity(simulation, segments, start_noise(segments))
    sd = sensor_noise(segments).double()
    return (slopes @ slopes.mT).mean(0) + torch.diag(sd.square().repeat(about.shape[1]))


@dataclass(frozen=True, eq=False)
class Correction:
    """What a simulator gets wrong on its baseline, as far as a network closes it."""

    effect: ResidualAcceleration | None
    """Correction at its strength; None where it did not help on what was held out."""
    covariance: Tensor
    """[D, D] of what remains wrong, for `noise_model`."""
    before: float
    """Misfit of held-out baseline segments without it."""
    after: float
    """Misfit with it."""
    held_out: Tensor
    """|W e|^2 / D [N] of the baseline segments, network and covariance from the other folds."""
    noise: NoiseModel
    """Noise model of the baseline segments, the covariance from the other folds."""

    @property
    def note(self) -> str:
        """What was done about the baseline, in one sentence."""
        was = f"on the baseline drives the simulator is off by {self.before:.2g} times the noise"
        if self.effect is None:
            return f"{was}; no correction that was learned there helps: so much is its own"
        return f"{was}, with a correction learned there by {self.after:.2g}: so much is its own"

    def simulation(self, simulation: Simulation) -> Simulation:
        """Simulation of the corrected simulator."""
        if self.effect is None:
            return simulation
        return replace(simulation, standing=(self.effect,))


def correct(
    simulation: Simulation,
    segments: Segments,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> Correction:
    """Closes a simulator's standing errors on the recordings on which it counts as right.

    A network learns the acceleration that the engine's steps lack. Its strength is the one of
    `STRENGTHS` with which rollouts come closest, each fold of the blocks predicted by a network
    trained on the others; what they still get wrong becomes the covariance. The network that is
    kept is trained on all.

    Args:
        simulation: Of the simulator.
        segments: Of the baseline recordings.
        seed: Of the networks' initial weights.
        progress: Told what is being done.

    Raises:
        ValueError: The recordings are too short to hold anything out.
    """
    fold = blocks(segments) % FOLDS
    if int(fold.max()) < FOLDS - 1:
        raise ValueError(
            f"the baseline drives have fewer than {FOLDS} blocks of {BLOCK:g} s: nothing is left "
            f"to judge a correction on; record at least {FOLDS * BLOCK:g} s"
        )
    progress("learning what the simulator gets wrong on the baseline")
    inputs, lacking = lacking_acceleration(simulation, segments)
    residuals = _held_out(simulation, segments, fold, (inputs, lacking, seed))
    plain = noise_model(simulation, segments)
    square = {s: plain.whiten(r[None])[0].square().sum(-1) for s, r in residuals.items()}
    best = min(STRENGTHS, key=lambda strength: float(plain.loss(square[strength]).sum()))
    effect = None
    if best:
        effect = ResidualAcceleration(
            model=trained(inputs, lacking, seed), strength=best, dt=segments.dt
        )
    sensed = sensed_covariance(simulation, segments)
    shrinkage = best_shrinkage(residuals[best], sensed, fold)
    crossed = _crossed(simulation, segments, residuals[best], sensed, shrinkage, fold)
    return Correction(
        effect=effect,
        covariance=standing_covariance(residuals[best], sensed, shrinkage),
        before=misfit(square[0.0] / plain.dimension),
        after=misfit(square[best] / plain.dimension),
        held_out=crossed.whiten(residuals[best][None])[0].square().sum(-1) / crossed.dimension,
        noise=crossed,
    )


def _held_out(
    simulation: Simulation,
    segments: Segments,
    fold: Tensor,
    training: tuple[Tensor, Tensor, int],
) -> dict[float, Tensor]:
    """Strength -> residuals [N, K, 6], each fold's with the network of the others."""
    inputs, lacking, seed = training
    found: dict[float, list[Tensor]] = {strength: [] for strength in STRENGTHS}
    for aside in range(FOLDS):
        rest = fold != aside
        network = trained(inputs[rest], lacking[rest], seed)
        for strength in STRENGTHS:
            effect = ResidualAcceleration(model=network, strength=strength, dt=segments.dt)
            corrected = replace(simulation, standing=(effect,))
            found[strength].append(corrected.residuals(segments[~rest])[0])
    order = torch.cat([(fold == aside).nonzero().squeeze(-1) for aside in range(FOLDS)])
    return {strength: torch.cat(parts)[order.argsort()] for strength, parts in found.items()}


def _crossed(simulation, segments, residuals, sensed, shrinkage, fold) -> NoiseModel:
    """Noise model of each fold of the segments, with what the others get wrong."""
    whitening = None
    for aside in fold.unique():
        rows = fold == aside
        extra = standing_covariance(residuals[~rows], sensed, shrinkage)
        part = noise_model(simulation, segments[rows], extra=extra).whitening
        if whitening is None:
            whitening = part.new_zeros(len(residuals), *part.shape[1:])
        whitening[rows] = part
    assert whitening is not None
    return NoiseModel(whitening, sensor_noise(segments))
