"""Composed physics beside the terms of the grammar: which of them it is, and with what coefficient.

A composed sort adds size f(signal) to a quantity of the car (`plants/composed.py`), a term adds
coefficient g(signal) (`effects/terms`). Both are computed at every row that was driven; the
coefficient of a term is that of the least squares, c = <f, g> / <g, g>, and its misfit
|f - c g| / |f|.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import ONE_WAY_REST, drive_of
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.effects.terms.banks import SHAPES_OF
from buggy_rl.effects.terms.grammar import LAG, PREFIX, Term, terms
from buggy_rl.proof.cases.term_forms import PLACES, has_form
from buggy_rl.proof.plants.composed import Disturbance

LIKE = 0.05  # misfit up to which a term is what was composed, whatever its form


@dataclass(frozen=True)
class TermMatch:
    """A term beside what was composed."""

    name: str
    misfit: float
    """[-] of what it explains least."""
    coefficient: float
    """Coefficient in the unit of the term."""
    alike: bool
    """Whether place, signal, shape and memory are the sort's by their names."""

    @property
    def right(self) -> bool:
        """Whether it is what was composed: by name, or as a function of what was driven."""
        return self.alike or self.misfit <= LIKE


def matches(disturbance: Disturbance, drives: Sequence[TensorDictBase]) -> dict[str, TermMatch]:
    """Every term that acts where a composed sort does, by name, best ones first.

    Args:
        disturbance: The sort with its numbers; it is set back before each drive.
        drives: Motion [T] with `pose`, `velocity` and `action`, one control period a row.
    """
    sort = disturbance.sort
    added = torch.cat([_added(disturbance, drive) for drive in drives])
    found = []
    for term in terms():
        if term.place == PLACES[sort.where]:
            shape = torch.cat([term_column(term, drive) for drive in drives])
            found.append(_match(term, added, shape, has_form(term, sort)))
    return {match.name: match for match in sorted(found, key=lambda m: (m.misfit, m.name))}


def in_grammar(found: dict[str, TermMatch]) -> TermMatch | None:
    """The term that is what was composed; None where the grammar has none, or nothing was added."""
    return next((match for match in found.values() if match.right), None)


def term_column(term: Term, drive: TensorDictBase) -> Tensor:
    """Shape of a term [T] along a drive, with its lag, at a coefficient of 1."""
    signals = _signals(drive)
    product = torch.ones_like(drive[keys.VELOCITY][:, 0], dtype=torch.float64)
    for name in term.signals:
        product = product * signals[name]
    shaped = SHAPES_OF[term.shape](product, term.bend)
    return _lagged(shaped) if term.memory == "lag" else shaped


def _signals(drive: TensorDictBase) -> dict[str, Tensor]:
    pose, velocity, action = (
        drive[key].double() for key in (keys.POSE, keys.VELOCITY, keys.ACTION)
    )
    vx, vy, r = velocity.unbind(-1)
    driven, steering = drive_of(action[:, 0], ONE_WAY_REST), action[:, 1]
    return {
        "one": torch.ones_like(vx),
        "speed": torch.hypot(vx, vy),
        "lateral_acceleration": vx * r,
        "yaw_rate": r,
        "steering": steering,
        "throttle": driven,
        "steering_rate": steering.diff(prepend=steering[:1]) / CONTROL_PERIOD,
        "throttle_rate": driven.diff(prepend=driven[:1]) / CONTROL_PERIOD,
        "time": CONTROL_PERIOD * torch.arange(1, len(vx) + 1, dtype=torch.float64),
        "x": pose[:, 0],
        "y": pose[:, 1],
        "heading": pose[:, 2],
    }


def _lagged(shaped: Tensor) -> Tensor:
    kept, state, rows = math.exp(-CONTROL_PERIOD / LAG), float(shaped[0]), []
    for value in shaped.tolist():
        state = kept * state + (1 - kept) * value
        rows.append(state)
    return torch.tensor(rows, dtype=torch.float64)


def _added(disturbance: Disturbance, drive: TensorDictBase) -> Tensor:
    """What a sort adds [T] along a drive, in the unit of the term's coefficient."""
    fresh = Disturbance(str(disturbance.sort), disturbance.numbers)
    columns = [drive[key].unsqueeze(1) for key in (keys.POSE, keys.VELOCITY, keys.ACTION)]
    added = torch.cat([fresh.added(*row) for row in zip(*columns, strict=True)]).double()
    # A term's throttle is a drive of 0 to 1, a sort's a command of -1 to 1.
    return added / (1.0 - ONE_WAY_REST) if disturbance.sort.where == "throttle" else added


def _match(term: Term, added: Tensor, shape: Tensor, alike: bool) -> TermMatch:
    size = float(added.norm())
    if size == 0.0:  # a threshold that was never reached: no drive shows it
        return TermMatch(term.name, 1.0, 0.0, alike=False)
    coefficient = float(added @ shape / (shape @ shape).clamp_min(1e-12))
    misfit = float((added - coefficient * shape).norm()) / size
    return TermMatch(term.name, misfit, coefficient, alike)


def is_term(name: str) -> bool:
    """Whether an effect is a term."""
    return name.startswith(PREFIX)
