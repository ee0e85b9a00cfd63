from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from buggy_rl.diagnosis import selection
from buggy_rl.diagnosis.search import State, tried_too
from buggy_rl.diagnosis.selection import Criteria, accepted, mends_baseline
from buggy_rl.estimation.cross_validation import blocks
from buggy_rl.estimation.misfit import BaselineMisfit
from tests.diagnosis.planted import planted_drives, problem_of


def candidate(effects: tuple[str, ...], nats: float, typical: float) -> SimpleNamespace:
    """With a loss of `nats` in each of its four blocks, and held-out squares of `typical`."""
    return SimpleNamespace(
        effects=effects,
        typical=typical,
        held_out=torch.full((4,), typical),
        cross_validated=SimpleNamespace(square=torch.full((4,), 2 * nats)),
        fit=SimpleNamespace(coordinates=[*effects, "clock"]),
    )


@pytest.mark.parametrize(
    ("gain", "after", "error", "helps"),
    [
        (2.1, 1.0, 0.0, True),  # without the best block 6.3 nats
        (1.9, 1.0, 0.0, False),  # 5.7
        (2.1, 3.9, 0.0, False),  # it closes less than one part in twenty of the first excess
        (2.1, 3.8, 0.0, True),
        (2.1, 3.8, 0.2, False),  # or less than the baseline's standard error
    ],
)
def test_an_effect_gains_nats_in_all_but_its_best_block_and_closes_a_share(
    gain, after, error, helps, monkeypatch
):
    null, better = candidate((), 10.0, 4.0), candidate(("drag",), 10.0 - gain, after)
    problem = SimpleNamespace(noise=SimpleNamespace(loss=lambda square, _: 0.5 * square))
    criteria = Criteria(torch.arange(4), usual=BaselineMisfit(error=error))
    monkeypatch.setattr(selection, "overlap", lambda *_: 0.0)
    assert accepted(criteria, problem, better, null, null) is helps  # type: ignore[arg-type]


def test_an_effect_must_close_more_where_another_does_the_same(monkeypatch):
    null, better = candidate((), 10.0, 4.0), candidate(("drag",), 7.0, 3.6)
    problem = SimpleNamespace(noise=SimpleNamespace(loss=lambda square, _: 0.5 * square))
    criteria, found = Criteria(torch.arange(4)), []
    for same in (0.0, 1.0):  # of the first excess 0.10 is closed: 0.05 and 0.15 are asked for
        monkeypatch.setattr(selection, "overlap", lambda *_, same=same: same)
        found.append(accepted(criteria, problem, better, null, null))  # type: ignore[arg-type]
    assert found == [True, False]


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
