"""The round trip's cases are the same in every car, and its table counts them."""

from pathlib import Path

from benchmarks.resumed import appended
from benchmarks.round_tripping.cases import (
    BRAKED,
    COLUMNS,
    FIRST,
    PEER,
    RoundTripConfig,
    case_of,
    effect_of,
    left,
    written,
)
from benchmarks.round_tripping.table import table

SEEDS = range(FIRST, FIRST + 80)


def test_every_effect_is_concealed_once_before_any_is_twice():
    names = [effect_of(seed) for seed in SEEDS]
    count = len(set(names))
    assert len(set(names[:count])) == count
    assert {"brake_gain", "drag_brake", "sensor_latency", "grip_patch"} <= set(names)


def test_a_seed_is_the_same_case_in_every_car():
    config = RoundTripConfig()
    seed = next(s for s in SEEDS if effect_of(s) == "yaw_damping")
    peer, buggy, large = (
        case_of(cell, seed, config) for cell in (PEER, (1.0, 20, BRAKED), (10.0, 20, BRAKED))
    )
    assert peer.concealed == buggy.concealed
    ratio = large.concealed["yaw_damping"]["rate"] / buggy.concealed["yaw_damping"]["rate"]
    assert abs(ratio - 10**-0.5) < 1e-4
    assert (buggy.rate, peer.rate, large.scale) == (20, 100, 10.0)
    assert peer.command == "throttle"


def test_it_goes_on_where_it_was_and_the_peer_has_no_fault_of_brakes(tmp_path):
    config = RoundTripConfig(seeds=40, together=40, output=str(tmp_path / "rows.csv"))
    own = {"brake_gain", "brake_balance", "reverse_deadband", "drag_brake"}
    (peer, seeds), *others = left(config)
    assert peer == PEER
    assert len(others) == 9
    assert not own & {effect_of(seed) for seed in seeds}
    row = {"scale": 1.0, "rate": 20, "pairing": BRAKED, "seed": FIRST, "right": 1, "named": 1}
    appended(Path(config.output), COLUMNS, row)
    still = dict(left(config))
    assert FIRST not in still[1.0, 20, BRAKED]
    assert FIRST in still[1.0, 50, BRAKED]


def test_the_table_counts_first_names_by_car_and_rate(tmp_path):
    file = tmp_path / "rows.csv"
    for scale, rate, right in ((1.0, 20, 1), (1.0, 20, 0), (10.0, 100, 1)):
        own = {"scale": scale, "rate": rate, "pairing": BRAKED, "right": right, "named": 1}
        appended(file, COLUMNS, own)
    lines = table(written(file)).splitlines()
    assert "| 1:10 | 20 | 1 of 2 | 9% to 91% | 2 |" in lines
    assert "| full size | all | 1 of 1 | 21% to 100% | 1 |" in lines
    assert "| all | 20 | 1 of 2 | 9% to 91% | 2 |" in lines
