"""An effect is as sure as the sets that have it are probable together."""

from types import SimpleNamespace

import pytest

from buggy_rl.diagnosis.answer.statement import confidences
from buggy_rl.diagnosis.search.posterior import Posterior


def test_an_effect_is_as_sure_as_all_sets_that_have_it_and_its_rivals_are_listed():
    posterior = Posterior(
        {(): 0.05, ("drag",): 0.5, ("bias", "drag"): 0.2, ("wind",): 0.15, ("lag",): 0.01}, 0.09
    )
    found = SimpleNamespace(best=SimpleNamespace(effects=("drag",)))
    sure = confidences(found, posterior)["drag"]  # type: ignore[arg-type]
    assert sure.probability == pytest.approx(0.7)
    assert sure.whatever_else == pytest.approx(0.7 / 0.86)
    assert sure.alternatives == {"wind": pytest.approx(0.15)}  # below 2 % none is listed


def test_a_name_is_never_surer_than_certain():
    posterior = Posterior({("drag",): 0.7, ("bias", "drag"): 0.3 + 1e-12}, 0.0)
    found = SimpleNamespace(best=SimpleNamespace(effects=("drag",)))
    assert confidences(found, posterior)["drag"].probability == 1.0  # type: ignore[arg-type]
