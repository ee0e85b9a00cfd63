"""A folder of cars: one job and one row of the table for each."""

import json
from pathlib import Path

import pytest

from buggy_rl.core.config import build
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.run.fleet import FleetConfig, fleet_jobs, fleet_rows
from buggy_rl.jobs import OUTCOME

GAIN = {"gain": {"value": 0.8, "unit": "-"}}
RATE = {"rate": {"value": 0.3, "unit": "1/s"}}
ANSWER = {
    "verdict": "missing_physics",
    "effects": [
        {"name": "steering_gain", "confidence": 0.9, "parameters": GAIN},
        {"name": "viscous_drag", "confidence": 0.7, "parameters": RATE},
    ],
    "fit": {"before": 9.0, "after": 2.0, "noise_floor": 1.0},
    "unexplained": {"share": 0.1},
}


@pytest.fixture
def cars(tmp_path) -> Path:
    for car in ("one", "two words, and a comma"):
        (tmp_path / "cars" / car).mkdir(parents=True)
        (tmp_path / "cars" / car / "drive.csv").write_text("t\n0\n")
    (tmp_path / "cars" / "notes.txt").touch()
    return tmp_path / "cars"


def config(cars: Path, **more) -> FleetConfig:
    own = {"simulator": "single_track", "cars": str(cars), "output": str(cars.parent / "out")}
    return FleetConfig(**{**own, **more})


def test_each_folder_of_the_folder_is_a_car(cars):
    jobs = fleet_jobs(config(cars, stretches=7, workers=3), Path("diagnose.py"))
    assert [job.name for job in jobs] == ["one", "two words, and a comma"]
    jobs[1].prepared(1)
    asked = build(DiagnosisConfig, [jobs[1].command[1]])
    assert asked.recordings == [str(cars / "two words, and a comma")]
    assert (asked.stretches, asked.workers) == (7, 0)
    assert Path(asked.output) == jobs[1].folder


def test_a_recording_that_changed_makes_its_car_alone_refused(cars):
    one, two = fleet_jobs(config(cars), Path("diagnose.py"))
    one.prepared(1)
    two.prepared(1)
    (cars / "one" / "drive.csv").write_text("t\n1\n")
    with pytest.raises(ValueError, match=r"before .*drive.csv had changed"):
        _ = one.done
    assert not two.done


def test_another_question_is_refused_with_what_differs_and_the_first_one_stays(cars):
    simulator = cars.parent / "my.py"
    simulator.write_text("import helper\n")
    (cars.parent / "helper.py").write_text("MASS = 1\n")
    question = config(cars, simulator=f"{simulator}:make")
    one, _ = fleet_jobs(question, Path("diagnose.py"))
    one.prepared(1)
    begun = (one.folder / "question.yaml").read_text()
    (cars.parent / "helper.py").write_text("MASS = 2\n")
    again, _ = fleet_jobs(question, Path("diagnose.py"))
    with pytest.raises(ValueError, match=r"helper\.py has other content now; use another output"):
        _ = again.done
    (cars.parent / "helper.py").write_text("MASS = 1\n")
    shorter = config(cars, simulator=f"{simulator}:make", seconds=0.5)
    again, _ = fleet_jobs(shorter, Path("diagnose.py"))
    with pytest.raises(ValueError, match=r"seconds was 1\.0, now 0\.5"):
        _ = again.done
    assert (one.folder / "question.yaml").read_text() == begun


def test_the_table_has_a_row_for_every_car_also_one_that_failed(cars):
    jobs = fleet_jobs(config(cars), Path("diagnose.py"))
    for job, status in zip(jobs, ("done", "failed"), strict=True):
        job.folder.mkdir(parents=True)
        ended = {"status": status, "seconds": 3.0, "last_words": ""}
        (job.folder / OUTCOME).write_text(json.dumps(ended))
    (jobs[0].folder / "diagnosis.json").write_text(json.dumps(ANSWER))
    first, second = fleet_rows(jobs)
    assert first["effects"] == "steering_gain + viscous_drag"
    assert first["values"] == "steering_gain.gain=0.8 -; viscous_drag.rate=0.3 1/s"
    assert (first["confidence"], first["error_before"], first["unexplained"]) == (0.7, 9.0, 0.1)
    assert second == {"car": "two words, and a comma", "status": "failed", "seconds": 3.0}


@pytest.mark.parametrize("given", [{}, {"cars": "fleet", "recordings": ["one.csv"]}])
def test_either_recordings_or_cars_are_needed(given):
    with pytest.raises(ValueError, match=r"either recordings=.*or cars="):
        FleetConfig(simulator="single_track", output="out", **given)


def test_a_folder_without_folders_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no folders there"):
        fleet_jobs(config(tmp_path), Path("diagnose.py"))
