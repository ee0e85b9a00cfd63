"""Drives in the place of recordings that cannot be shipped: what a new user does with them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from buggy_rl.core.car_file import load_car
from buggy_rl.core.config import build
from buggy_rl.inspection.folder import inspect_folder
from buggy_rl.proof.cases.twin import TwinColumn, TwinConfig, foreign, parameters, recorded
from buggy_rl.recordings import load_recordings

CONFIGS = Path(__file__).parents[2] / "configs" / "twins"
TWINS = {"mocap_30hz": 20.0, "rally_gps": 6.0, "full_size": 4.0}  # [s] of a short drive


def config_of(name, folder, *options):
    own = [f"output={folder / name}", "drives=1", "period=0.02", *options]
    return build(TwinConfig, [str(CONFIGS / f"{name}.yaml"), *own])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder of each twin, short."""
    folder = tmp_path_factory.mktemp("twins")
    for name, seconds in TWINS.items():
        assert list(recorded(config_of(name, folder, f"seconds={seconds}")))[-1] == 1.0
    return folder


@pytest.mark.slow
def test_the_proposed_map_of_the_small_car_is_right(made):
    check_proposal(made / "mocap_30hz")


@pytest.mark.slow  # larger cars take longer until they have shown all that is looked for
@pytest.mark.parametrize("name", ["rally_gps", "full_size"])
def test_the_proposed_map_of_larger_cars_is_right(tmp_path, name):
    list(recorded(config_of(name, tmp_path, "seconds=60")))
    check_proposal(tmp_path / name)


def check_proposal(folder):
    proposed = yaml.safe_load(inspect_folder(folder / "before").proposal)
    right = yaml.safe_load((folder / "answer" / "columns.yaml").read_text())
    assert proposed["names"] == right["names"]
    assert proposed.get("units", {}) == right.get("units", {})
    assert proposed["command"] == right["command"]
    assert proposed.get("time_from_first", False) == right.get("time_from_first", False)
    sides = [np.sign(m["steering"]["left"] - m["steering"]["right"]) for m in (proposed, right)]
    assert sides[0] == sides[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", TWINS)
def test_most_frames_are_kept_and_none_is_made_up(made, name):
    columns = made / name / "answer" / "columns.yaml"
    car = str(made / name / "car.yaml")
    recordings, refusals = load_recordings([str(made / name)], columns, car=car)
    assert refusals == []
    assert len(recordings) == 2
    for recording in recordings:
        raw = pd.read_csv(recording.source)
        time = raw.iloc[:, 0].to_numpy()
        stamps = (time - time[0]) * {"frame_ms": 1e-3}.get(raw.columns[0], 1.0)
        assert recording.duration > 0.8 * TWINS[name]
        gaps = np.flatnonzero(np.diff(stamps) > 2.5 * np.median(np.diff(stamps)))
        inside = recording.data["t"].flatten().numpy()
        begin = inside[0]
        for gap in gaps:
            low, high = begin + stamps[gap], begin + stamps[gap + 1]
            assert not ((inside > low + 0.02) & (inside < high - 0.02)).any()


@pytest.mark.slow
def test_what_has_changed_is_in_the_answer_and_nowhere_else(made):
    own = config_of("full_size", made)
    answer = yaml.safe_load((made / "full_size" / "answer" / "truth.yaml").read_text())
    assert answer["changed"] == {"steering_offset": 0.02}
    car = str(made / "full_size" / "car.yaml")
    before, after = (parameters(own, car, changed) for changed in (False, True))
    assert set(after) - set(before) == {"steering_offset"}
    assert load_car(car).command.kind == "throttle_brake_reverse"
    with pytest.raises(ValueError, match="no parameter tyres; available: brake_force"):
        parameters(replace(own, changed={"tyres": 1.0}), car, True)


def test_a_foreign_table_has_other_units_and_wraps_its_heading():
    values = {name: np.array([0.5]) for name in ("t", "x", "vx", "vy")} | {"yaw": np.array([4.0])}
    table = {
        "yaw": TwinColumn("deg", 57.29577951, 0.0, 3),
        "speed": TwinColumn("kmh", 3.6, 0.0, 2),
        "x": TwinColumn("mm", 1000.0, 10.0, 0),
        "qz": TwinColumn("q_z"),
    }
    [row] = foreign(values, table).to_dict("records")
    # 4 rad - 2 pi = -130.816 degrees; hypot(0.5, 0.5) = 0.70711 m/s; sin(2) = 0.909297.
    assert row == pytest.approx({"deg": -130.817, "kmh": 2.55, "mm": 510.0, "q_z": 0.909297})
    with pytest.raises(ValueError, match="no channel mood; available: t, x"):
        foreign(values, {"mood": TwinColumn("m")})
