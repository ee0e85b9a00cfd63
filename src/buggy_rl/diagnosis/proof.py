"""How far rollouts are from what was held out, before and after."""

from collections.abc import Sequence

import torch
from torch import Tensor

from buggy_rl.diagnosis.evidence import BLOCK, blocks
from buggy_rl.diagnosis.fit import Fitted, Fitter
from buggy_rl.diagnosis.library import Library
from buggy_rl.diagnosis.likelihood import Likelihood
from buggy_rl.diagnosis.rollouts import Player
from buggy_rl.diagnosis.stretches import Stretches
from buggy_rl.evaluation import HORIZONS

FOLDS = 2


def folds(cut: Stretches) -> Tensor:
    """Fold [N] of each stretch: whole drives where there are several, else blocks in turn."""
    drives = cut.drive.unique()
    if len(drives) >= FOLDS:
        rank = {int(d): i % FOLDS for i, d in enumerate(drives)}
        return torch.tensor([rank[int(d)] for d in cut.drive])
    return blocks(cut) % FOLDS


def held_out_fits(
    player: Player, cut: Stretches, likelihood: Likelihood, library: Library, fitted: Fitted
) -> list[tuple[Tensor, Fitted]]:
    """Fits an explanation anew to all folds but one, for each: (rows held out, fitted)."""
    fold = folds(cut)
    result = []
    for number in fold.unique():
        kept = torch.nonzero(fold != number).flatten()
        fitter = Fitter(player, cut[kept], likelihood[kept], library)
        start = fitter.start(fitted.causes, fitted.place.tolist())
        result.append((torch.nonzero(fold == number).flatten(), fitter.fit([start], 3)[0]))
    return result


def position_mse(
    player: Player, library: Library, cut: Stretches, fitted: Fitted, rows: Tensor | None = None
) -> Tensor:
    """Squared distance [m^2] at each instant, [N, K], of rollouts by an explanation."""
    part = cut if rows is None else cut[rows]
    settings = library.settings([(fitted.unknowns, fitted.place)])
    gap = player.play(part, *settings)[0]
    return gap[..., :2].square().sum(-1)


def by_horizon(square: Tensor, instants: Tensor, dt: float) -> dict[float, float]:
    """Mean over stretches and over time up to each horizon [m^2], the original's equation 5.2."""
    result = {}
    for horizon in HORIZONS:
        within = instants <= round(horizon / dt)
        if int(instants[-1]) >= round(horizon / dt):
            result[horizon] = float(square[:, within].mean())
    return result


def held_out_mse(
    player: Player,
    library: Library,
    cuts: Sequence[Stretches],
    fits: Sequence[tuple[Tensor, Fitted]],
    owner: Stretches,
) -> dict[float, float]:
    """Position errors by horizon of stretches whose drive, or block, was held out of the fit.

    Args:
        player: Plays into the simulator.
        library: Of the causes.
        cuts: The same drives cut into stretches of several lengths.
        fits: From `held_out_fits` over `owner`.
        owner: The stretches that the folds are of.
    """
    fold_of_block: dict[int, int] = {}
    keys_owner = _keys(owner)
    for number, (rows, _) in enumerate(fits):
        for row in rows.tolist():
            fold_of_block[int(keys_owner[row])] = number
    result: dict[float, float] = {}
    for cut in cuts:
        keys = _keys(cut)
        number = torch.tensor([fold_of_block.get(int(k), -1) for k in keys])
        parts = []
        for index, (_, fitted) in enumerate(fits):
            rows = torch.nonzero(number == index).flatten()
            if len(rows):
                parts.append(position_mse(player, library, cut, fitted, rows))
        if parts:
            result |= by_horizon(torch.cat(parts), player.instants(cut), cut.dt)
    return result


def _keys(cut: Stretches) -> Tensor:
    return cut.drive * 100_000 + (cut.row.double() * cut.dt / BLOCK).long()
