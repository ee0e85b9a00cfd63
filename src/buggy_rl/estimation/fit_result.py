"""What a fit found, whether it can be trusted, and its file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from buggy_rl.core.parameters import Parameter
from buggy_rl.estimation.rollout import ParameterSets, Simulation
from buggy_rl.estimation.segments import Segments
from buggy_rl.simulators.base import HoldEngine

AT_BOUND = "it lies at the edge of its range"


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter."""

    parameter: Parameter
    """Parameter as declared, with the value the fit started from."""
    value: float
    low: float
    """Lower end of the 95 % interval."""
    high: float
    """Upper end."""
    warnings: tuple[str, ...] = ()
    """What the drives cannot tell about it, in plain words."""


@dataclass(frozen=True)
class Fit:
    """Estimates, and what they are worth on the segments they were fitted to."""

    estimates: Sequence[Estimate]
    converged: bool
    """False where the solver used up its iterations."""
    error: float
    """Rms position error of the fitted simulator over the segments [m]."""
    hold_error: float
    """The same of holding the last velocity [m]."""

    @property
    def warnings(self) -> list[str]:
        """Why the fit should not be trusted, one line each; none for a sound fit."""
        found = []
        if not self.error < self.hold_error:
            found.append(
                f"the fitted simulator is no better than holding the last velocity: rms position "
                f"error {self.error:.3g} m against {self.hold_error:.3g} m on the segments it was "
                "fitted to; check units, signs and ranges of the commands, and the car (car=...)"
            )
        if not self.converged:
            found.append("the fit did not converge: raise fit.iterations")
        bound = [e.parameter.name for e in self.estimates if AT_BOUND in e.warnings]
        if bound:
            found.append(
                f"at the edge of their ranges: {', '.join(bound)}; the car differs from what the "
                "ranges allow: name it (car=...), widen them (fit_options.ranges.NAME=[low,high]) "
                "or fix them (fit.fixed)"
            )
        return found


def position_errors(
    simulation: Simulation, segments: Segments, settings: ParameterSets
) -> tuple[float, float]:
    """Rms position errors [m] of a simulator with one set of parameters, and of holding the last.

    Args:
        simulation: The simulator's rollouts.
        segments: Started as they are.
        settings: One set of parameters.
    """
    dt = segments.dt
    hold = replace(simulation, make=lambda count: HoldEngine(count, dt=dt), options={})
    off = [simulation.residuals(segments, settings)[0], hold.residuals(segments)[0]]
    squares = [residual[..., :2].square().sum(-1).mean() for residual in off]
    fitted, held = torch.stack(squares).sqrt().tolist()
    return fitted, held


def as_simulator(
    engine: str,
    fit: Fit,
    options: Mapping[str, Any],
    parameters: Mapping[str, float] | None = None,
    asked: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """A fit as the content of a simulator file that `make_engine` reads.

    Args:
        engine: What was fitted.
        fit: Its result.
        options: Of the engine.
        parameters: That were given and not fitted.
        asked: Question that the fit answers.
    """
    fitted = {e.parameter.name: round(e.value, 6) for e in fit.estimates}
    content = {
        "engine": engine,
        "options": dict(options),
        "parameters": {**(parameters or {}), **fitted},
        "_fit": {
            e.parameter.name: {
                "low": round(e.low, 6),
                "high": round(e.high, 6),
                "unit": e.parameter.unit,
                "started_from": e.parameter.value,
                "warnings": list(e.warnings),
            }
            for e in fit.estimates
        },
    }
    content |= {"_question": dict(asked)} if asked else {}
    return content | ({"_warnings": fit.warnings} if fit.warnings else {})
