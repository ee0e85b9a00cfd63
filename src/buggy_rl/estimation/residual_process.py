"""A residual acceleration learned from rollouts, not from single steps alone.

Accelerations of single steps are buried in the noise of a derivative, and what is small in each of
them but lasts decides where a rollout ends. The residual is linear in its weights, so these are
found as a fit's numbers are: from accelerations by ridge regression first, then by Gauss-Newton on
rollouts of `WINDOW`, whose derivatives follow from those of the simulator's steps:

    ds_{k+1} = A_k ds_k + B phi(x_k) dw dt,   A_k the derivative of step k by the velocity.

How strong the priors are is what brings rollouts nearest to recordings that were held out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import torch
from torch import Tensor, nn

from buggy_rl.core.vehicle import VehicleDimensions, shift_velocity
from buggy_rl.effects.residual import ResidualAcceleration, lagged_commands
from buggy_rl.effects.residual_models import MOTION, ResidualProcess
from buggy_rl.estimation.baseline import BOUND, lacking_acceleration, span_means
from buggy_rl.estimation.evidence import closeness
from buggy_rl.estimation.noise_model import NoiseModel, noise_model
from buggy_rl.estimation.rollout import (
    MOST_ENVIRONMENTS,
    ParameterSets,
    Simulation,
    along_heading,
)
from buggy_rl.estimation.segments import Segments

WINDOW = 0.4  # [s] of rollouts that are fitted to: in longer ones a spin hides what led to it
SPAN = 0.2  # [s] over which accelerations are averaged before they are compared
RIDGES = (0.003, 0.03, 0.3, 3.0, 1e9)  # of accelerations: tried; the last is none at all
PRIORS = (0.1, 1.0, 10.0, 1e3)  # [-] precision of the weights beside rollouts: tried
STEPS = (0.0, 1e3)  # [-] weight of accelerations beside rollouts: tried
SHARES = (0.3, 1.0)  # [-] of the way to a solution: tried
TRIED = tuple(product(STEPS, PRIORS, SHARES))
ITERATIONS = 4
LEAST = 2e-3  # [-] gain in `closeness` below which no iteration follows


@dataclass(frozen=True, eq=False)
class Rows:
    """Segments, each of which belongs to one of several models that are learned beside each other.

    To learn from: a segment of a fold that is held out belongs to the models of the others.
    """

    segments: Segments
    group: Tensor
    """[N] model of each."""
    settings: ParameterSets
    """One set, with numbers of each segment; what is in place meanwhile."""


@dataclass(frozen=True)
class Recipe:
    """How strong the priors were, in each stage of learning."""

    ridge: float
    iterations: tuple[tuple[float, float, float], ...] = ()
    """Weight of accelerations, precision of the weights, share of the way."""
    baseline: bool = False
    """Whether it learned from a baseline too."""


@dataclass(frozen=True, eq=False)
class Learned:
    """Models of groups of segments, and how they were found."""

    models: list[ResidualProcess]
    recipe: Recipe
    distance: float
    """`closeness` of rollouts that were held out, their mean."""


def learned(
    simulation: Simulation, data: Rows, groups: int, held_out: Rows, noise: NoiseModel
) -> Learned:
    """Models of groups of segments, by the recipe with which held-out rollouts come nearest.

    Args:
        simulation: Of the simulator; alone in its process.
        data: To learn from.
        groups: Number of models.
        held_out: Segments, each with the model that has not learned from it.
        noise: Of the sensor, for `held_out`.
    """
    learner = _Learner(simulation, data, groups)

    def distance(candidates: Tensor) -> Tensor:
        found = learner.rolled(candidates, held_out)
        return closeness(noise.whiten(found).square().mean(-1)).mean(-1)

    ridged = torch.stack([learner.ridged(ridge) for ridge in RIDGES])
    far = distance(ridged)
    best = int(far.argmin())
    weights, nearest, recipe = ridged[best], float(far[best]), Recipe(RIDGES[best])
    for _ in range(ITERATIONS):
        system = learner.system(weights)
        candidates = torch.stack([learner.moved(weights, system, each) for each in TRIED])
        far = distance(candidates)
        best = int(far.argmin())
        if float(far[best]) > nearest - LEAST:
            break
        weights, nearest = candidates[best], float(far[best])
        recipe = replace(recipe, iterations=(*recipe.iterations, TRIED[best]))
    return Learned(learner.models(weights), recipe, nearest)


def relearned(simulation: Simulation, data: Rows, recipe: Recipe) -> ResidualProcess:
    """The model of all segments, by a recipe that was found with some of them held out."""
    learner = _Learner(simulation, data, 1)
    weights = learner.ridged(recipe.ridge)
    for each in recipe.iterations:
        weights = learner.moved(weights, learner.system(weights), each)
    return learner.models(weights)[0]


class _Learner:
    """Weights [G, F, 3] of G models, in units of `unit`, from data that each has for itself."""

    def __init__(self, simulation: Simulation, data: Rows, groups: int) -> None:
        self.simulation, self.groups = simulation, groups
        inputs, lacking = lacking_acceleration(simulation, data.segments, data.settings)
        inputs = torch.cat([inputs, _past(data.segments)], -1)
        span = max(1, round(SPAN / data.segments.dt))
        self.plain: list[ResidualProcess] = []
        self.steps: list[tuple[Tensor, Tensor]] = []
        sizes = []
        for group in range(groups):
            own, wanted = inputs[data.group == group], lacking[data.group == group]
            model, means = _scaled(own, wanted), span_means(wanted, span)
            size = means.square().mean((0, 1)).sqrt().clamp_min(1e-3)
            self.plain.append(model)
            self.steps.append(_regression(span_means(model.features(own), span), means / size))
            sizes.append(size / model.bound)
        self.unit = torch.stack(sizes)  # (G, 3): a weight of 1 is as much as is lacking
        windows, part = data.segments.windows(WINDOW)
        self.data = Rows(windows, data.group[part], data.settings.map(lambda v: _of(v, part)))
        self.noise = noise_model(simulation, windows).of_sensor

    def models(self, weights: Tensor) -> list[ResidualProcess]:
        """Models with weights [G, F, 3]."""
        return [_with(m, weights[g] * self.unit[g]) for g, m in enumerate(self.plain)]

    def ridged(self, ridge: float) -> Tensor:
        """Weights from accelerations alone."""
        return torch.stack([_solved(gram, along, ridge) for gram, along in self.steps])

    def rolled(self, candidates: Tensor, rows: Rows) -> Tensor:
        """Residuals [C, N, K, 6] of rollouts with candidates of the weights [C, G, F, 3]."""
        most = max(1, MOST_ENVIRONMENTS // len(rows.segments))
        return torch.cat([self._rolled(part, rows) for part in candidates.split(most)])

    def _rolled(self, candidates: Tensor, rows: Rows) -> Tensor:
        weights = (candidates * self.unit.unsqueeze(1))[:, rows.group].flatten(0, 1)
        model = by_row(self.plain, rows.group.repeat(len(candidates)))
        simulation = _with_model(self.simulation, _with(model, weights), rows.segments.dt)
        nowhere = torch.zeros(len(candidates), 6)
        return simulation.residuals(rows.segments, rows.settings, nowhere)

    def system(self, weights: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Curvature [P, P] and slope [P] of each model's misfit of rollouts, P = 3 F."""
        model = by_row(self.models(weights), self.data.group)
        residuals, slopes = rollout_and_slopes(self.simulation, self.data, model)
        whitened = self.noise.whiten(residuals.unsqueeze(0))[0]
        slopes = slopes * self.unit[self.data.group][:, None, None, None]
        whitening = self.noise.whitening
        jacobian = torch.einsum("nij,njp->nip", whitening, slopes.flatten(3).flatten(1, 2).double())
        found = []
        for group in range(self.groups):
            own = self.data.group == group
            square = whitened[own].square().mean(-1)
            typical = float(square.median().clamp_min(1.0))
            weight = 1 / (1 + square / typical) / typical  # a spin counts for little
            weight = weight * jacobian[own].isfinite().all(-1).all(-1)
            slope = jacobian[own].nan_to_num(0.0, 0.0, 0.0)
            found.append(
                (
                    torch.einsum("ndp,ndq,n->pq", slope, slope, weight),
                    torch.einsum("ndp,nd,n->p", slope, whitened[own], weight),
                )
            )
        return found

    def moved(
        self,
        weights: Tensor,
        system: Sequence[tuple[Tensor, Tensor]],
        options: tuple[float, float, float],
    ) -> Tensor:
        """Weights [G, F, 3] a share of the way to the solution of the linearised problem."""
        steps, prior, share = options
        moved = []
        for own, (curvature, slope), (gram, along) in zip(weights, system, self.steps, strict=True):
            total = curvature + steps * torch.kron(gram, torch.eye(3).double())
            total.diagonal().add_(prior)
            z = own.double()
            downhill = slope + (steps * (gram @ z - along) + prior * z).flatten()
            change = torch.linalg.solve(total, -downhill)
            moved.append((z + share * change.view_as(z)).float())
        return torch.stack(moved)


def rollout_and_slopes(
    simulation: Simulation, rows: Rows, model: ResidualProcess
) -> tuple[Tensor, Tensor]:
    """Residuals of rollouts with a model in place, and their derivatives by its weights.

    Latent states, of the simulator and of effects, count as if they did not follow the motion, and
    what the sensor shows as if it were the motion: for a Gauss-Newton step that is near enough.

    Args:
        simulation: Of the simulator.
        rows: N segments.
        model: With weights [N, F, 3].

    Returns:
        [N, K, 6] as `Simulation.residuals`, and [N, K, 6, F, 3].
    """
    segments = rows.segments
    dt, count = segments.dt, len(segments)
    watched = _Watched(model, count)
    simulation = _with_model(simulation, watched, dt)
    arm = shift_velocity(torch.eye(3), VehicleDimensions().sensor_to_cg).mT
    moving = torch.zeros(count, 3, model.size, 3)  # derivatives of the velocity by the weights
    placed = torch.zeros_like(moving)  # and of the pose
    read, slopes = [], []
    wanted = set(simulation.instants(segments).tolist())
    for row, step in enumerate(simulation.linear_steps(segments, rows.settings), start=1):
        features, share = model.slope(watched.seen)
        given = torch.einsum("ij,nj,nf->nifj", arm, share, features) * dt
        later = torch.einsum("nij,njfk->nifk", step.slope, moving) + given
        placed = placed + dt * _displaced(
            step.pose, step.velocity, 0.5 * (moving + later), placed, dt
        )
        moving = later
        if row in wanted:
            read.append(step.read)
            slopes.append(torch.cat([placed, moving], 1))
    measured = segments.measured[:, segments.start + simulation.instants(segments)]
    residuals = along_heading(torch.stack(read, 1) - measured, segments)
    turned = torch.stack(slopes, 1).movedim(2, -1)  # (N, K, F, 3, 6)
    shape = turned.shape
    turned = along_heading(turned.flatten(1, 3), segments).view(shape)
    return residuals, turned.movedim(-1, 2)


def _displaced(pose: Tensor, velocity: Tensor, mean: Tensor, placed: Tensor, dt: float) -> Tensor:
    """Derivative of the pose's rate [N, 3, F, 3] by the weights, as `integrate_pose` has it."""
    vx, vy, r = velocity.mean(0).unbind(-1)
    heading = pose[0, :, 2] + 0.5 * dt * r
    cos, sin = torch.cos(heading), torch.sin(heading)
    turned = placed[:, 2] + 0.5 * dt * mean[:, 2]
    along, across = (v.view(-1, 1, 1) for v in (cos * vx - sin * vy, sin * vx + cos * vy))
    cos, sin = cos.view(-1, 1, 1), sin.view(-1, 1, 1)
    x = cos * mean[:, 0] - sin * mean[:, 1] - across * turned
    y = sin * mean[:, 0] + cos * mean[:, 1] + along * turned
    return torch.stack([x, y, mean[:, 2]], 1)


class _Watched(nn.Module):
    """A model of some rows of a batch, and in the rest the same; keeps what it saw last.

    Args:
        model: With weights of N rows.
        count: N.
    """

    needs_past = True

    def __init__(self, model: ResidualProcess, count: int) -> None:
        super().__init__()
        self.model, self.count = model, count
        self.seen = torch.empty(0)

    def forward(self, inputs: Tensor) -> Tensor:
        """Acceleration [C N, 3] of inputs [C N, 12], C copies of the rows."""
        copies = inputs.unflatten(0, (-1, self.count))
        self.seen = copies[0].cpu()
        return self.model(copies).flatten(0, 1)


def by_row(models: Sequence[ResidualProcess], owner: Tensor) -> ResidualProcess:
    """A model in whose row each has the model [n] that it belongs to."""
    shared = ("projection", "phase")
    states = [model.state_dict() for model in models]
    rows = {
        name: value if name in shared else torch.stack([s[name] for s in states])[owner]
        for name, value in states[0].items()
    }
    return _of_state(models[0].count, rows)


def _with(model: ResidualProcess, weights: Tensor) -> ResidualProcess:
    return _of_state(model.count, {**model.state_dict(), "weights": weights})


def _of_state(count: int, state: dict[str, Tensor]) -> ResidualProcess:
    model = ResidualProcess(count)
    for name, value in state.items():
        model.register_buffer(name, value)
    return model


def _with_model(simulation: Simulation, model: nn.Module, dt: float) -> Simulation:
    effect = ResidualAcceleration(model=model, strength=1.0, dt=dt)  # type: ignore[arg-type]
    return replace(simulation.alone, standing=(*simulation.standing, effect))


def _past(segments: Segments) -> Tensor:
    """Lagged commands [N, H, 4] at the rows of the rollouts."""
    action, past = segments.action.clamp(-1, 1), []
    late = torch.zeros(len(segments), 4)
    for row in range(segments.start + segments.horizon):
        known = torch.full((len(segments), 1), row > 0)
        late = lagged_commands(late, action[:, row], known, segments.dt)
        past.append(late)
    return torch.stack(past[segments.start :], 1)


def _scaled(inputs: Tensor, lacking: Tensor) -> ResidualProcess:
    """A model without weights for inputs [N, H, 12] and accelerations [N, H, 3]."""
    model, flat = ResidualProcess(), inputs.flatten(0, 1)
    model.mean.copy_(flat.mean(0))
    model.scale.copy_(flat.std(0).clamp_min(1e-3))
    model.low.copy_(flat[:, :MOTION].amin(0))
    model.high.copy_(flat[:, :MOTION].amax(0))
    model.bound.copy_(BOUND * lacking.square().mean((0, 1)).sqrt().clamp_min(1e-3))
    return model


def _regression(features: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
    """Mean products [F, F] and [F, 3] of features [N, B, F] and targets [N, B, 3]."""
    square = targets.square().mean((1, 2))
    weight = (1 / (1 + square / square.median().clamp_min(1e-12))).double()
    weight = weight / len(features) / features.shape[1]
    features, targets = features.double(), targets.double()
    gram = torch.einsum("nbf,nbg,n->fg", features, features, weight)
    return gram, torch.einsum("nbf,nbk,n->fk", features, targets, weight)


def _solved(gram: Tensor, along: Tensor, ridge: float) -> Tensor:
    return torch.linalg.solve(gram + ridge * torch.eye(len(gram)).to(gram), along).float()


def _of(values: Tensor, part: Tensor) -> Tensor:
    """Values [C, N] of segments, or [C], for parts of them."""
    return values if values.dim() == 1 else values[:, part]
