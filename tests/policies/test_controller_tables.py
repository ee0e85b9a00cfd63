from dataclasses import replace

import pytest
import yaml

from buggy_rl.core.config import build, plain_values
from buggy_rl.policies.controllers.path_tracking import PurePursuitConfig
from buggy_rl.policies.evaluation.controller_tables import (
    DriverTablesConfig,
    driver_results,
    driver_table,
    tuned_driver,
)
from buggy_rl.policies.training.run import EngineConfig
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.paths.making import PathConfig

SMALL = DriverTablesConfig(
    output="nowhere",
    engine=EngineConfig("single_track"),
    task=TaskConfig(paths=PathConfig(count=20, validation_count=2, waypoints=60)),
    tuning_paths=3,
    candidates=8,
    rounds=2,
    steps=150,
    random_paths=2,
)


@pytest.fixture(scope="module")
def found():
    """Pure pursuit tuned, with the steps that were counted."""
    counted = []
    best, trials = tuned_driver(SMALL, "pure_pursuit", lambda: counted.append(1))
    return best, trials, len(counted)


def test_tuning_tries_every_candidate_and_counts_its_steps(found):
    best, trials, counted = found
    assert len(trials) == 16
    assert 150 < counted <= 300
    assert best.speed.top_speed == trials[0].values["speed.top_speed"]
    within = [t for t in trials if t.lateral_rms <= SMALL.lateral_limit]
    assert trials[0].waypoints == max(t.waypoints for t in within)


def test_tuned_numbers_come_back_from_yaml(found, tmp_path):
    file = tmp_path / "pure_pursuit.yaml"
    file.write_text(yaml.safe_dump(plain_values(found[0])))
    assert build(PurePursuitConfig, [str(file)]) == found[0]


@pytest.mark.slow
def test_tuned_drivers_and_a_random_one_drive_every_course(found, monkeypatch):
    for name in ("STEPS", "RANDOM_STEPS"):  # 3 s in place of 10
        monkeypatch.setattr(f"buggy_rl.policies.evaluation.drives.{name}", 300)
    short = TaskConfig(paths=replace(SMALL.task.paths, waypoints=15))
    config = replace(SMALL, task=short, engine=EngineConfig("kinematic"))
    rows = list(driver_results(config, {"pure_pursuit": found[0]}))
    courses = ["training", "validation", "lap", "infinity", "random"]
    assert [(r.driver, r.course) for r in rows] == [
        (driver, course) for driver in ("pure_pursuit", "random") for course in courses
    ]
    assert [len(r.scores.waypoints) for r in rows[:5]] == [2, 2, 1, 1, 1]
    assert rows[2].scores.waypoints.mean() > 2 * rows[7].scores.waypoints.mean()
    text = driver_table(rows, {"pure_pursuit": found[1][0]}, config)
    assert f"| pure_pursuit | lap | {float(rows[2].scores.waypoints.mean()):.1f} | 100% |" in text
    assert f"speed.top_speed {found[0].speed.top_speed:.3f}" in text
    assert text.count("\n|") == 2 + 10


def test_only_known_drivers_can_be_tuned():
    with pytest.raises(ValueError, match="no controller 'random' to tune"):
        tuned_driver(SMALL, "random", lambda: None)
