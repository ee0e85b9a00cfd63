"""Coverage of step tests is counted against the car's own, and its form error is found."""

import numpy as np
import pytest

from buggy_rl.diagnosis.search.posterior import FormError
from buggy_rl.proof.calibrate.intervals import (
    STEPS_TRIED,
    form_error,
    has_truth,
    step_intervals,
    steps,
)
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.ledger import Entry


def entries(share, count=300):
    """Cases with a quantity of 1 that is off by a share of it, and knows of a tenth of that."""
    chance = np.random.default_rng(0)
    made = []
    for seed in range(count):
        off = float(chance.normal(0.0, share))
        line = {
            "name": ("acceleration", "coasting")[seed % 2],
            "value": 1.0,
            "size": 1.0,
            "spread": 0.1 * share,
            "apart": 0.0,
            "true": 1.0 + off,
        }
        concealed = {("payload", "wind", "tire_grip")[seed % 3]: {}}
        case = Case(seed, "reference", "reference", True, concealed)
        made.append(Entry(case.id, opened=case, steps=(line,)))
    return made


def coverage(table, row):
    [line] = [line for line in table.splitlines() if line.startswith(f"| {row} |")]
    return [int(cell.split(" %")[0]) for cell in line.split("|")[2:4]]


@pytest.mark.parametrize("share", [0.03, 0.1])
def test_the_form_error_covers_what_the_spread_alone_does_not(share):
    cases = entries(share)
    form = form_error(steps(cases), STEPS_TRIED)
    assert 0.7 * share < form.sd(1.0, 0.1 * share, 0.0) < 1.6 * share
    within, alone = coverage(step_intervals(cases), "all")
    assert within >= 92
    assert alone < 30  # a tenth of a standard deviation
    assert coverage(step_intervals(cases, FormError(1.0, 0.001, 0.0)), "coasting")[0] < 30


def test_ledgers_without_step_tests_say_so():
    without = Entry("0000001", opened=Case(1, "reference", "reference"))
    assert steps([without]) == []
    assert "none in these ledgers" in step_intervals([without])


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({}, True),
        ({"concealed": {"payload": {"mass_ratio": 1.3}}}, True),
        ({"concealed": {"sensor_latency": {"dead_time": 0.05}}}, False),
        ({"nuisance": "stamps"}, False),
        ({"rate": 25}, False),
    ],
)
def test_a_plant_is_the_truth_only_where_the_sensor_shows_its_motion(more, expected):
    assert has_truth(Case(seed=0, plant="reference", simulator="reference", **more)) is expected
