import pytest
import torch

from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.confidence import SAME, VARIED, constancy
from buggy_rl.diagnosis.constancy import WORDS, Varying, conditions, varying
from buggy_rl.estimation.cross_validation import blocks, evidence
from buggy_rl.estimation.gauss_newton import Fitter
from tests.diagnosis.planted import fitter, planted_drives

DRAGS = [
    {"viscous_drag": {"rate": 0.5}},
    {"aerodynamic_drag": {"coefficient": 0.25}},
]


@pytest.fixture(scope="module")
def fits():
    """To drives of a car with linear and one with quadratic drag."""
    return [fitter(drives) for drives in planted_drives(DRAGS)]


def explained(fit: Fitter, cause: str) -> list[Candidate]:
    """The simulator as given, and with a cause."""
    group = blocks(fit.cut)
    fitted = fit.fit([fit.start(()), fit.start([cause])])
    return [Candidate(each, evidence(fit, each, group)) for each in fitted]


def changing(fit: Fitter, cause: str) -> Varying:
    null, best = explained(fit, cause)
    return varying(fit, best, null, blocks(fit.cut), cause)


def test_the_number_of_what_is_there_is_one_number(fits):
    assert changing(fits[0], "viscous_drag").closes < SAME


def test_the_number_of_a_lookalike_changes_with_how_one_drives(fits):
    # c v^2 in place of k v: k = c v.
    found = changing(fits[1], "viscous_drag")
    assert found.condition == "vx"
    assert found.closes > SAME
    assert found.nats > 0


def test_nothing_is_rolled_out_for_it(fits, monkeypatch):
    fit = fits[1]
    null, best = explained(fit, "viscous_drag")
    monkeypatch.setattr(fit, "evaluate", None)
    assert varying(fit, best, null, blocks(fit.cut), "viscous_drag").nats > 0


def test_conditions_are_counted_about_their_median(fits):
    cut = fits[0].cut
    found = conditions(cut, fits[0].player.instants(cut))
    assert set(found) == set(WORDS)
    for value in found.values():
        assert value.shape == (len(cut),)
        assert float(value.median()) == pytest.approx(0.0, abs=1e-9)
        assert float(value.abs().max()) <= 3.0


def test_what_does_not_change_in_any_stretch_is_no_condition(fits):
    cut = fits[0].cut
    cut = cut[torch.zeros(3, dtype=torch.long)]
    assert conditions(cut, fits[0].player.instants(cut)) == {}


@pytest.mark.parametrize(
    ("more", "closed", "sure"),
    [
        (0.0, 1.0, 1.0),
        (SAME, 1.0, 1.0),
        (SAME + 2.0 * VARIED, 2.0, 0.5),
        (SAME + 2.0 * VARIED, 1.0, 0.2),
        (1.0, 0.0, 0.0),
    ],
)
def test_a_name_is_less_sure_by_what_varying_closes_of_what_it_closes(more, closed, sure):
    assert constancy(Varying("vx", more, 100.0), closed) == pytest.approx(sure, abs=1e-6)
