"""What could be known of a case: its true structure, fitted to the drives that the tool had."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import torch
import yaml

from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.equivalents import expected
from buggy_rl.blind_test.exam import write_json
from buggy_rl.blind_test.sealing import Vault
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.effects import EFFECTS
from buggy_rl.effects.measuring import measurable_options
from buggy_rl.estimation.baseline import correct
from buggy_rl.estimation.gauss_newton import Fitted, Fitter
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.noise_model import likelihood
from buggy_rl.estimation.rollout import Player
from buggy_rl.estimation.screening import screened
from buggy_rl.estimation.segments import Stretches, stretches
from buggy_rl.recordings import Recording, load_recordings
from buggy_rl.task.env import make_simulator

SECONDS = 1.0  # [s] open loop
ITERATIONS = 8


def weigh(vault: Vault, case: Case, effects: Sequence[str] = (), rivals: int = 6) -> int:
    """Fits the truth to a case's drives, measures all on those held out, and writes it down.

    Args:
        vault: Where the case lies.
        case: The case.
        effects: That the tool could choose from; empty for the whole library.
        rivals: Other single effects that are fitted, the most promising ones.

    Returns:
        1, the number of cases.
    """
    torch.set_num_threads(1)
    try:
        result = weighed(vault, case, effects, rivals)
    except (ValueError, RuntimeError) as error:  # a plant that spins, a drive in too many pieces
        result = {"failed": f"{type(error).__name__}: {error}"}
    write_json(vault.weighed(case.id), result)
    return 1


def weighed(vault: Vault, case: Case, effects: Sequence[str], rivals: int) -> dict[str, Any]:
    """What `weigh` writes: losses in nats, parameters, rivals, errors on the sealed drives."""
    seen = vault.seen(case.id)
    question = yaml.safe_load((seen / "question.yaml").read_text())
    most = question.get("stretches", DiagnosisConfig.stretches)
    make = _maker(seen / question["simulator"])
    player = Player(make, options=measurable_options(make)[0])
    extra = None
    if case.baseline:
        correction = correct(player, _cut(_drives(seen / "baseline"), most))
        player, extra = correction.player(player), correction.covariance
    cut = _cut(_drives(seen / "recordings"), most)
    library = Library(list(effects) or None)
    fitter = Fitter(player, cut, likelihood(player, cut, extra=extra), library)
    null = fitter.fit([fitter.start(())], ITERATIONS)[0]
    truth = _truth(fitter, case) if set(case.truth) <= set(EFFECTS) and case.truth else None
    result: dict[str, Any] = {"null": _loss(fitter, null)}
    if truth is not None:
        # How much worse than noise the truth is: so much less does a nat count.
        fitter.temper = max(1.0, float(truth.square.median()) / fitter.likelihood.readings)
        truth = fitter.fit([fitter.start(truth.causes, truth.place.tolist())], ITERATIONS)[0]
        result |= {
            "temper": fitter.temper,
            "nats": _loss(fitter, null) - _loss(fitter, truth),
            "parameters": {e: v for e, v in truth.values().items() if e},
        }
        if len(case.truth) == 1:
            result["rivals"] = _rivals(fitter, null, truth, rivals)
        else:
            result["rivals"] = _fewer(fitter, truth)
    held_out = _cut(_drives(vault.held_out(case.id)), DiagnosisConfig.stretches)
    repaired = vault.said(case.id) / "repaired.yaml"
    result["held_out"] = _measured(player, library, held_out, null, truth, repaired)
    return result


def _truth(fitter: Fitter, case: Case) -> Fitted:
    """The true structure, fitted from the true numbers on."""
    begin = fitter.start(case.truth)
    values = {effect: expected(case, effect) for effect in case.truth}
    place = [
        # What a plant has no number for begins at neutral.
        float(u.parameter.coordinate(values[u.cause].get(u.parameter.name, u.parameter.value)))
        if u.cause
        else 0.0
        for u in begin.unknowns
    ]
    return fitter.fit([fitter.start(case.truth, place)], ITERATIONS)[0]


def _rivals(fitter: Fitter, null: Fitted, truth: Fitted, most: int) -> dict[str, float]:
    """Nats by which the truth beats other single effects; only the closest are fitted."""
    promising = screened(fitter, null, most + 1)
    starts = [start for start in promising if start.causes != truth.causes][:most]
    own = _loss(fitter, truth)
    return {f.causes[0]: _loss(fitter, f) - own for f in fitter.fit(starts, ITERATIONS)}


def _fewer(fitter: Fitter, truth: Fitted) -> dict[str, float]:
    """Nats by which the truth beats itself without one of its effects, by what is left."""
    numbers = list(zip(truth.unknowns, truth.place.tolist(), strict=True))
    starts = []
    for effect in truth.causes:
        others = [cause for cause in truth.causes if cause != effect]
        starts.append(fitter.start(others, [z for u, z in numbers if u.cause != effect]))
    own = _loss(fitter, truth)
    fitted = fitter.fit(starts, ITERATIONS)
    return {"+".join(f.causes): _loss(fitter, f) - own for f in fitted}


def _measured(
    player: Player,
    library: Library,
    cut: Stretches,
    null: Fitted,
    truth: Fitted | None,
    repaired: Path,
) -> dict[str, dict[str, float]]:
    """Errors of 1 s rollouts on sealed drives, all by one clock: the oracle's.

    With baseline drives `player` has the correction of what was wrong before the change, as
    the repaired simulator has: closing that is no merit of a name.

    Returns:
        as_given, oracle and named -> `error`, the root mean square of whitened gaps, and
        `position`, the root mean square distance [m]; both means over stretches.
    """
    weighed = likelihood(player, cut)
    clock = (truth or null).place[-1:]
    start = torch.zeros(1, dtype=torch.float64)
    own = Fitted((), library.unknowns(()), start, torch.empty(0))
    settings = library.settings([(own.unknowns, clock)])
    gaps = {"as_given": player.play(cut, *settings)}
    if truth is not None:
        gaps["oracle"] = player.play(cut, *library.settings([(truth.unknowns, truth.place)]))
    if repaired.exists():
        gaps["named"] = Player(_maker(repaired)).play(cut, *settings)
    return {
        name: {
            "error": float(weighed.white(gap)[0].square().mean(-1).sqrt().mean()),
            "position": float(gap[0, ..., :2].square().sum(-1).mean(-1).sqrt().nanmean()),
        }
        for name, gap in gaps.items()
    }


def _loss(fitter: Fitter, fitted: Fitted) -> float:
    return fitter.value(fitted)


def _maker(simulator: Path) -> Callable[[int], Any]:
    return cache(lambda cars: make_simulator(str(simulator), cars))


def _drives(folder: Path) -> list[Recording]:
    return load_recordings([str(folder)])[0]


def _cut(recordings: Sequence[Recording], most: int) -> Stretches:
    cut = stretches(recordings, SECONDS, SECONDS)
    if len(cut) > most:
        cut = cut[torch.linspace(0, len(cut) - 1, most).round().long()]
    return cut
