"""Validation: how far rollouts are from recordings that nothing was fitted to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from buggy_rl.effects import effect_class
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.estimation.cross_validation import BLOCK, blocks
from buggy_rl.estimation.gauss_newton import Problem, fitted
from buggy_rl.estimation.hypothesis import OWN, Hypothesis, Library
from buggy_rl.estimation.residual_network import lacking_acceleration, trained
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import HORIZONS, Segments, cut_segments
from buggy_rl.recordings import Recording

FOLDS = 2
ITERATIONS = 2  # of a fit to a part of the recordings, from the one to all of them
TRIMS = ("throttle_gain", "throttle_offset", "steering_gain", "steering_offset")
"""What anyone would turn at to make a simulator fit that has no parameters of its own."""


@dataclass
class Errors:
    """Distances of rollouts from what was measured, by horizon [s]."""

    mean_square: dict[float, float] = field(default_factory=dict)
    """Over segments and over time up to the horizon [m^2], the original's equation 5.2."""
    median: dict[float, float] = field(default_factory=dict)
    """Over segments, of the root of each one's own mean square [m]."""
    square: Tensor = field(default_factory=lambda: torch.empty(0))
    """|W e|^2 / D [N] of the segments that are fitted to, each when it was held out."""

    def add(self, square: Tensor, instants: Tensor, dt: float) -> None:
        """Counts squared distances [N, K] at all horizons that they reach.

        One segment in which a car spins outweighs a hundred others in a mean square; in the median
        it does not.
        """
        for horizon in HORIZONS:
            within = instants <= round(horizon / dt)
            if int(instants[-1]) >= round(horizon / dt) and len(square):
                of_segment = square[:, within].mean(1)
                self.mean_square[horizon] = float(of_segment.mean())
                self.median[horizon] = float(of_segment.sqrt().median())


def validated(
    problem: Problem, best: Hypothesis, recordings: Sequence[Recording]
) -> dict[str, Errors]:
    """Errors of rollouts over recordings, or blocks of them, that nothing was fitted to.

    Args:
        problem: What `best` was fitted to.
        best: The hypothesis; fitted anew for each fold that is held out.
        recordings: That the segments were cut from.

    Returns:
        `before`: as given. `after`: with the effects. `retuned`: with the simulator's own
        parameters fitted instead, or `TRIMS` where it declares none. `black_box`: with a network
        instead that was trained on the accelerations it lacks.
    """
    fold = folds(problem.segments)
    aside = [torch.nonzero(fold == n).flatten() for n in range(int(fold.max()) + 1)]
    starts = {"after": best}
    own = _retunable(problem.library)
    if own:
        starts["retuned"] = problem.library.at(own, best.named())
    sets = {"before": [problem.library.hypothesis(())] * len(aside)}
    sets |= _refits(problem, starts, aside)
    networks = _networks(problem, aside)
    result = {name: Errors() for name in (*sets, "black_box")}
    for part in _lengths(problem.segments, recordings):
        owner, fitted_to = _owners(part, problem.segments, fold), part is problem.segments
        part, owner = part[owner >= 0], owner[owner >= 0]
        instants = problem.simulation.instants(part)
        # Each segment at the vector of the fit that it was held out of.
        rows = [(fits[0], torch.stack([f.vector for f in fits])[owner]) for fits in sets.values()]
        residuals = problem.simulation.residuals(part, problem.library.settings(rows))
        for name, residual in zip(sets, residuals, strict=True):
            result[name].add(_distance(residual), instants, part.dt)
            if fitted_to:
                whitened = problem.noise.whiten(residual.unsqueeze(0))[0]
                result[name].square = whitened.square().mean(-1)
        held_out = [
            _distance(network.residuals(part[owner == n])[0])
            for n, network in enumerate(networks)
            if bool((owner == n).any())
        ]
        result["black_box"].add(torch.cat(held_out), instants, part.dt)
    return result


def folds(segments: Segments) -> Tensor:
    """Fold [N] of each segment: whole recordings where there are several, else blocks in turn."""
    recordings = segments.recording.unique()
    if len(recordings) >= FOLDS:
        rank = {int(r): i % FOLDS for i, r in enumerate(recordings)}
        return torch.tensor([rank[int(r)] for r in segments.recording])
    return blocks(segments) % FOLDS


def _distance(residuals: Tensor) -> Tensor:
    """Squared distances [N, K] of residuals [N, K, 6]."""
    return residuals[..., :2].square().sum(-1)


def _retunable(library: Library) -> tuple[str, ...]:
    own = tuple(OWN + name for name in library.parameters if library.own)
    return own or tuple(n for n in TRIMS if n in library.effects and effect_class(n).declared)


def _lengths(segments: Segments, recordings: Sequence[Recording]) -> list[Segments]:
    """The segments, and longer ones, no more of them, for the horizons beyond them."""
    result = [segments]
    for seconds in HORIZONS:
        if seconds > segments.horizon * segments.dt:
            try:
                longer = cut_segments(recordings, seconds, seconds)
                result.append(longer.spread(len(segments)))
            except ValueError:
                continue  # no gap-free part is that long
    return result


def _refits(
    problem: Problem, starts: Mapping[str, Hypothesis], aside: Sequence[Tensor]
) -> dict[str, list[Hypothesis]]:
    """Hypotheses fitted anew to all that is not held out, for each fold that is."""
    by_fold = [
        fitted(problem[_rest(problem.segments, rows)], list(starts.values()), ITERATIONS)
        for rows in aside
    ]
    return {name: [fits[k] for fits in by_fold] for k, name in enumerate(starts)}


def _networks(problem: Problem, aside: Sequence[Tensor]) -> list[Simulation]:
    """For each fold that is held out, the simulator with a network that learned from the rest."""
    simulation = problem.simulation
    inputs, lacking = lacking_acceleration(simulation, problem.segments)
    result = []
    for rows in aside:
        rest = _rest(problem.segments, rows)
        network, dt = trained(inputs[rest], lacking[rest], 0), problem.segments.dt
        effect = ResidualAcceleration(model=network, strength=1.0, dt=dt)
        result.append(replace(simulation, standing=(*simulation.standing, effect)))
    return result


def _rest(segments: Segments, aside: Tensor) -> Tensor:
    """Rows that are not set aside; of a single block, which proves nothing, all."""
    kept = torch.ones(len(segments), dtype=torch.bool)
    kept[aside] = False
    return torch.nonzero(kept if bool(kept.any()) else ~kept).flatten()


def _owners(part: Segments, segments: Segments, fold: Tensor) -> Tensor:
    """Fold [N] of segments of another length; -1 where their block has none."""
    owner = dict(zip(_blocks(segments), fold.tolist(), strict=True))
    return torch.tensor([owner.get(block, -1) for block in _blocks(part)])


def _blocks(segments: Segments) -> list[tuple[int, int]]:
    block = (segments.row.double() * segments.dt / BLOCK).long()
    return list(zip(segments.recording.tolist(), block.tolist(), strict=True))
