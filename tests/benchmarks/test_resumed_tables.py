"""Benchmarks that go on where they stopped: rows that are kept, and what tables count of them."""

from types import SimpleNamespace

import pytest
from benchmarks.deciding import cases as deciding
from benchmarks.gripping import named
from benchmarks.gripping.black_boxes import BLACK_BOXES
from benchmarks.resumed import appended, rows_of

from buggy_rl.core import keys


def test_rows_are_appended_below_one_head_and_read_again(tmp_path):
    file = tmp_path / "results" / "table.csv"
    assert rows_of(file, ("a", "b")) == []
    appended(file, ("a", "b"), {"a": 1})
    appended(file, ("a", "b"), {"b": 0.5, "a": "x"})
    assert rows_of(file, ("a", "b")) == [{"a": "1", "b": ""}, {"a": "x", "b": "0.5"}]
    with pytest.raises(ValueError, match=r"table.csv: columns \['a', 'b'\], expected \['a', 'c'\]"):
        rows_of(file, ("a", "c"))


def effect(name, confidence, grip=0.5):
    return SimpleNamespace(
        name=name, confidence=confidence, parameters={"grip": SimpleNamespace(value=grip)}
    )


@pytest.mark.parametrize(
    ("effects", "met"),
    [
        ([effect("tire_grip", 0.95, 0.42)], 1),
        ([effect("tire_grip", 0.95, 0.45)], 0),  # 12.5 % off
        ([effect("tire_grip", 0.85, 0.42)], 0),
        ([effect("payload", 0.96), effect("tire_grip", 0.95, 0.42)], 0),
        ([], 0),
    ],
)
def test_a_grip_is_met_if_it_is_first_sure_and_close(effects, met):
    case = ("mujoco", 0.4, 1)
    row = named.judged(case, "missing_physics", effects)
    assert row["met"] == met
    assert row["first"] == (effects[0].name if effects else "")


def test_cases_in_the_output_are_not_run_again(tmp_path):
    config = named.NamedConfig(output=str(tmp_path / "grip.csv"), seeds=[7])
    assert len(named.left(config)) == 12
    row = named.judged(("mujoco", 0.4, 7), "missing_physics", [effect("tire_grip", 0.95, 0.42)])
    appended(tmp_path / "grip.csv", named.COLUMNS, row)
    assert ("mujoco", 0.4, 7) not in named.left(config)
    assert len(named.left(config)) == 11
    lines = named.table(named.written(tmp_path / "grip.csv")).splitlines()
    assert lines[-1] == "| all | 1 | 1 | 1 | 1 | 5.0 % |"


@pytest.mark.parametrize("plant", ["reference", "mujoco"])
def test_a_black_box_declares_nothing(plant):
    car = BLACK_BOXES[plant](2)
    assert set(car.observation_spec.keys()) >= {keys.POSE, keys.VELOCITY}
    assert not any(hasattr(car, name) for name in ("declared", "realises", "vehicle"))


def test_the_table_of_decisions_sets_predicted_beside_achieved(tmp_path):
    file = tmp_path / "manoeuvres.csv"
    rows = [
        {"truth": "a", "before": "a"},  # sure at once
        {"manoeuvre": "coast", "predicted": 0.9, "truth": "a", "between": "a or b", "decided": 1},
        {"manoeuvre": "coast", "predicted": 1.0, "truth": "c", "between": "a or b", "wrong": 1},
        {"manoeuvre": "creep", "predicted": 0.2, "truth": "a", "between": "a or b"},
    ]
    for row in rows:
        appended(file, deciding.COLUMNS, {"decided": 0, "wrong": 0, **row})
    lines = deciding.table(deciding.written(file)).splitlines()
    assert lines[0] == "4 cases, 1 decided at once"
    assert lines[4].endswith("| 3 | 70% | 33% | 33% |")
    assert lines[5].endswith("| 2 | 95% | 50% | 50% |")
    assert lines[6].endswith("| 2 | 55% | 50% | 0% |")
