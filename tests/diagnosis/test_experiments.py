"""Which manoeuvre decides between what steady drives leave open."""

from dataclasses import replace

import pytest
import torch

from buggy_rl.diagnosis import experiments
from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.experiments import ENOUGH, TIMES, decided, suggestions
from buggy_rl.diagnosis.manoeuvres import MANOEUVRES
from buggy_rl.estimation.cross_validation import blocks, evidence
from buggy_rl.estimation.gauss_newton import Fitter
from tests.diagnosis.planted import commands, fitter, planted_drives

DRAGGY = {"viscous_drag": {"rate": 0.1}}
CAUSES = ("viscous_drag", "aerodynamic_drag", "steering_gain")


def measured(action, seed=0):
    """Drives of a car with more drag, told `action` [cars, rows, 2]."""
    return planted_drives([DRAGGY], len(action), seed=seed, action=action)[0]


def steady():
    """At one throttle, weaving: speed hardly changes."""
    return measured(commands(2, 1500, drive=(0.3, 0.3)))


def explained(fit, cause):
    """One cause, fitted, with what speaks for it."""
    found = fit.fit([fit.start([cause], [0.5, 0.0])])[0]
    return Candidate(found, evidence(fit, found, blocks(fit.cut)))


@pytest.fixture(scope="module")
def undecided():
    """A fit to steady drives of a car that has more drag, by three causes."""
    fit = fitter(steady(), CAUSES)
    return fit, [explained(fit, cause) for cause in CAUSES]


@pytest.fixture(scope="module")
def nats(undecided):
    """Of each manoeuvre: the first from the second, and from itself."""
    fit, (best, rival, _) = undecided
    return decided(fit, best, [rival, best])[0]


def named(name):
    return [m.name for m in MANOEUVRES].index(name)


def test_a_manoeuvre_decides_as_it_was_foretold(undecided, nats):
    fit, candidates = undecided
    alone = [fit.value(candidate.fitted) for candidate in candidates[:2]]
    foretold = float(nats[0, named("slow_slalom")])
    told = MANOEUVRES[named("slow_slalom")].actions(0.01).expand(TIMES, -1, -1)
    both = fitter([*steady(), *measured(told, seed=1)], CAUSES)
    values = [both.value(explained(both, c).fitted) for c in CAUSES[:2]]
    gained = (values[1] - values[0]) - (alone[1] - alone[0])
    assert foretold > ENOUGH
    assert 0.5 * foretold < gained < 2 * foretold


def test_no_manoeuvre_tells_an_explanation_from_itself(nats):
    assert float(nats[1].abs().max()) < 1e-6


def test_a_car_is_not_asked_to_go_much_faster_than_it_was_driven(undecided, nats):
    fit, (best, rival, _) = undecided
    assert nats[0, named("full_throttle")] == 0
    faster = replace(fit.cut, smooth_velocity=2 * fit.cut.smooth_velocity)
    other = Fitter(fit.player, faster, fit.likelihood, fit.library)
    assert decided(other, best, [rival])[0][0, named("full_throttle")] > ENOUGH


def test_one_manoeuvre_is_asked_for_where_one_tells_all(undecided):
    fit, (best, *rivals) = undecided
    lines = suggestions(fit, best, rivals)
    assert any(lines[0].startswith(m.words) for m in MANOEUVRES)
    assert "tells viscous_drag from " in lines[0]
    assert all(f"from {cause}" in " ".join(lines) for cause in CAUSES[1:])
    assert len(lines) < 3
    assert suggestions(fit, best, []) == []


def test_what_a_simulator_was_never_taught_decides_nothing(undecided, monkeypatch):
    fit, (best, rival, _) = undecided
    shown = experiments._driven

    def beyond(*given):
        recordings, outside = shown(*given)
        return recordings, torch.ones_like(outside)

    monkeypatch.setattr(experiments, "_driven", beyond)
    assert suggestions(fit, best, [rival]) == []
