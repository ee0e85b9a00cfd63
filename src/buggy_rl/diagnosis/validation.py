"""How far rollouts are from what was held out: as given, repaired, and mended in other ways."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from buggy_rl.effects import effect_class
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.estimation.baseline import lacking_acceleration, trained
from buggy_rl.estimation.cross_validation import BLOCK, blocks
from buggy_rl.estimation.gauss_newton import Fitted, Fitter
from buggy_rl.estimation.hypothesis import OWN, Library
from buggy_rl.estimation.noise_model import Likelihood
from buggy_rl.estimation.rollout import Player
from buggy_rl.estimation.segments import HORIZONS, Stretches, stretches
from buggy_rl.recordings import Recording

FOLDS = 2
ITERATIONS = 2  # of a fit to a part of the drives, from the one to all of them
TRIMS = ("throttle_gain", "throttle_offset", "steering_gain", "steering_offset")
"""What anyone would turn at to make a simulator fit that has no parameters of its own."""


@dataclass
class Errors:
    """Distances of rollouts from what was measured, by horizon [s]."""

    mean_square: dict[float, float] = field(default_factory=dict)
    """Over stretches and over time up to the horizon [m^2], the original's equation 5.2."""
    median: dict[float, float] = field(default_factory=dict)
    """Over stretches, of the root of each one's own mean square [m]."""
    white: Tensor = field(default_factory=lambda: torch.empty(0))
    """[N] |W e|^2 / D of the stretches that are fitted to, each when it was held out."""

    def add(self, square: Tensor, instants: Tensor, dt: float) -> None:
        """Counts squared distances [N, K] at all horizons that they reach.

        One stretch in which a car spins outweighs a hundred others in a mean square; in the median
        it does not.
        """
        for horizon in HORIZONS:
            within = instants <= round(horizon / dt)
            if int(instants[-1]) >= round(horizon / dt) and len(square):
                of_stretch = square[:, within].mean(1)
                self.mean_square[horizon] = float(of_stretch.mean())
                self.median[horizon] = float(of_stretch.sqrt().median())


def prove(
    player: Player,
    recordings: Sequence[Recording],
    cut: Stretches,
    likelihood: Likelihood,
    library: Library,
    best: Fitted,
) -> dict[str, Errors]:
    """Errors of rollouts over drives, or blocks of drives, that nothing was fitted to.

    Args:
        player: Plays into the simulator.
        recordings: That `cut` was cut from.
        cut: Stretches that `best` was fitted to.
        likelihood: Of their gaps.
        library: Of the causes.
        best: The explanation; fitted anew for each part that is held out.

    Returns:
        `before`: as given. `after`: with the causes. `retuned`: with the simulator's own
        parameters fitted instead, or `TRIMS` where it declares none. `black_box`: with a network
        instead that was trained on the accelerations it lacks.
    """
    cuts = [cut]
    for seconds in HORIZONS:
        if seconds > cut.horizon * cut.dt:
            try:
                cuts.append(stretches(recordings, seconds, seconds))
            except ValueError:
                continue  # no stretch is that long
    fold = folds(cut)
    number = int(fold.max()) + 1
    aside = [torch.nonzero(fold == n).flatten() for n in range(number)]
    own = tuple(OWN + name for name in library.parameters if library.own)
    retuned = own or tuple(
        name for name in TRIMS if name in library.effects and effect_class(name).declared
    )
    sets = {"after": _refits(player, cut, likelihood, library, best, aside)}
    if retuned:
        numbers = zip(best.unknowns, best.place.tolist(), strict=True)
        known = {(u.cause, u.parameter.name): z for u, z in numbers}
        unknowns = library.unknowns(retuned)
        place = [known.get((u.cause, u.parameter.name), 0.0) for u in unknowns]
        begin = Fitter(player, cut, likelihood, library).start(retuned, place)
        sets["retuned"] = _refits(player, cut, likelihood, library, begin, aside)
    result = {name: Errors() for name in ("before", *sets, "black_box")}
    networks = _networks(player, cut, aside)
    for part in cuts:
        owner, part_of_fit = _owners(part, cut, fold), part is cut
        part, owner = part[owner >= 0], owner[owner >= 0]
        instants = player.instants(part)
        square = player.play(part, {})[0, ..., :2].square().sum(-1)  # (N, K)
        result["before"].add(square, instants, part.dt)
        # Each stretch at the place of the fit that it was held out of.
        places = [torch.stack([f.place for f in fits])[owner] for fits in sets.values()]
        unknowns = [fits[0].unknowns for fits in sets.values()]
        settings = library.settings(list(zip(unknowns, places, strict=True)))
        gaps = player.play(part, *settings)  # (C, N, K, 6)
        for name, gap in zip(sets, gaps, strict=True):
            result[name].add(gap[..., :2].square().sum(-1), instants, part.dt)
            if part_of_fit:
                result[name].white = likelihood.white(gap.unsqueeze(0))[0].square().mean(-1)
        held_out = torch.cat(
            [
                network.play(part[owner == n], {})[0, ..., :2].square().sum(-1)
                for n, network in enumerate(networks)
                if bool((owner == n).any())
            ]
        )
        result["black_box"].add(held_out, instants, part.dt)
    return result


def folds(cut: Stretches) -> Tensor:
    """Fold [N] of each stretch: whole drives where there are several, else blocks in turn."""
    drives = cut.drive.unique()
    if len(drives) >= FOLDS:
        rank = {int(d): i % FOLDS for i, d in enumerate(drives)}
        return torch.tensor([rank[int(d)] for d in cut.drive])
    return blocks(cut) % FOLDS


def _refits(
    player: Player,
    cut: Stretches,
    likelihood: Likelihood,
    library: Library,
    fitted: Fitted,
    aside: Sequence[Tensor],
) -> list[Fitted]:
    """The explanation fitted anew to all that is not held out, for each part that is."""
    result = []
    for rows in aside:
        rest = _rest(cut, rows)
        fitter = Fitter(player, cut[rest], likelihood[rest], library)
        start = fitter.start(fitted.causes, fitted.place.tolist())
        result.append(fitter.fit([start], ITERATIONS)[0])
    return result


def _networks(player: Player, cut: Stretches, aside: Sequence[Tensor]) -> list[Player]:
    """For each part that is held out, the simulator with a network that learned from the rest."""
    inputs, lacking = lacking_acceleration(player, cut)
    result = []
    for rows in aside:
        rest = _rest(cut, rows)
        effect = ResidualAcceleration(model=trained(inputs[rest], lacking[rest], 0), strength=1.0)
        result.append(replace(player, standing=(*player.standing, effect)))
    return result


def _rest(cut: Stretches, aside: Tensor) -> Tensor:
    """Rows that are not set aside; of a single block, which is no proof, all."""
    kept = torch.ones(len(cut), dtype=torch.bool)
    kept[aside] = False
    return torch.nonzero(kept if bool(kept.any()) else ~kept).flatten()


def _owners(part: Stretches, cut: Stretches, fold: Tensor) -> Tensor:
    """Fold [N] of stretches of another length; -1 where their block has none."""
    owner = dict(zip(_places(cut), fold.tolist(), strict=True))
    return torch.tensor([owner.get(place, -1) for place in _places(part)])


def _places(cut: Stretches) -> list[tuple[int, int]]:
    block = (cut.row.double() * cut.dt / BLOCK).long()
    return list(zip(cut.drive.tolist(), block.tolist(), strict=True))
