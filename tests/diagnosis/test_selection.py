from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from buggy_rl.diagnosis.search import State, tried_too
from buggy_rl.diagnosis.selection import Criteria, accepted, mends_baseline, required_gain
from buggy_rl.estimation.cross_validation import blocks
from buggy_rl.estimation.misfit import NO_BASELINE, BaselineMisfit
from tests.diagnosis.planted import planted_drives, problem_of


def required(first, overlapping=0.0, size=0.0, usual=NO_BASELINE):
    return required_gain(Criteria(torch.zeros(1), usual=usual), first, overlapping, size)


@pytest.mark.parametrize(
    ("first", "usual", "overlapping", "least"),
    [
        (4.0, BaselineMisfit(), 0.0, 0.2),  # one part in twenty of the first excess
        (4.0, BaselineMisfit(), 1.0, 0.6),  # three, of what does just what another effect does
        (0.1, BaselineMisfit(), 0.0, 0.01),  # and never less than the least gain
        (1.0, BaselineMisfit(mean=0.1, error=0.2), 0.0, 0.2),  # nor than the standard error
        # As right as on its baseline: half of the excess, or a quarter that is more than any effect
        # closes where nothing is wrong.
        (0.2, BaselineMisfit(mean=0.5), 0.0, 0.1),
        (0.4, BaselineMisfit(mean=0.5), 0.0, 0.15),
        (2.0, BaselineMisfit(mean=3.0), 0.0, 0.5),
        (0.6, BaselineMisfit(mean=0.5), 0.0, 0.03),  # more than that: something has changed
    ],
)
def test_the_excess_that_an_effect_must_close(first, usual, overlapping, least):
    assert required(first, overlapping, usual=usual) == pytest.approx(least)


@pytest.mark.parametrize(
    ("size", "least"),
    [
        (0.1, 0.2),  # small for its kind: one part in twenty
        (0.5, 0.2),
        (1.0, 0.05),  # twice the typical size: a quarter of that
        (9.0, 0.02),  # never less than a tenth of it
    ],
)
def test_a_large_effect_must_close_less(size, least):
    assert required(4.0, 0.0, size) == pytest.approx(least)
    # However large, it must close more where it does what another effect does.
    assert required(4.0, 1.0, size) == pytest.approx(0.4 + least)


def plain(square):
    """The noise model's loss, for hand computation."""
    return 0.5 * square


@pytest.mark.parametrize(("there", "mended"), [(0.9, False), (1.1, True), (5.0, True)])
def test_an_effect_mends_the_baseline_that_gains_a_fifth_of_its_gain_there(there, mended):
    # Gain on the new recordings: (20 - 10) / 2 = 5 a segment, a fifth of which is 1.
    noise = SimpleNamespace(loss=plain)
    alone = SimpleNamespace(vector=torch.ones(1))
    asked = []

    def at(effects, known):
        asked.append((effects, known))
        return alone

    baseline = SimpleNamespace(
        library=SimpleNamespace(at=at),
        whitened=lambda rows: [torch.full((3, 1), v**0.5) for v in (20.0, 20.0 - 2 * there)],
        noise=noise,
    )
    square = torch.full((4,), 20.0)
    less = SimpleNamespace(effects=("old",), cross_validated=SimpleNamespace(square=square))
    more = SimpleNamespace(
        effects=("new", "old"),
        cross_validated=SimpleNamespace(square=square - 10.0),
        fit=SimpleNamespace(named=lambda: {("new", "gain"): 0.7, ("", "clock_offset"): 0.4}),
    )
    criteria = Criteria(torch.zeros(4), baseline=baseline)  # type: ignore[arg-type]
    problem = SimpleNamespace(noise=noise)
    assert mends_baseline(criteria, problem, more, less) is mended  # type: ignore[arg-type]
    # The further effect alone, with a right clock.
    assert asked == [(("new",), {("new", "gain"): 0.7, ("", "clock_offset"): 0.0})]


def test_an_effect_that_mends_the_baseline_equally_is_not_accepted():
    # The car steers too little now as it did on the baseline.
    case = {"steering_gain": {"gain": 0.8}}
    before, after = (planted_drives([case], seed=seed)[0] for seed in (1, 2))
    problem, baseline = (
        problem_of(recordings, ["steering_gain"]) for recordings in (after, before)
    )
    criteria = Criteria(blocks(problem.segments))
    starts = [problem.library.hypothesis(effects) for effects in ((), ("steering_gain",))]
    state, (null, gain) = tried_too(State(problem, {}), starts, criteria)
    assert accepted(criteria, state.problem, gain, null, null)
    with_baseline = replace(criteria, baseline=baseline)
    assert not accepted(with_baseline, state.problem, gain, null, null)
