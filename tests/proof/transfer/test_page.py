"""Tables, page and figure."""

import json
from dataclasses import replace

import matplotlib.pyplot as plt
import pytest

from buggy_rl.core.files import write_atomically, write_json
from buggy_rl.proof.transfer.page import transfer_figure, transfer_page, write_page
from buggy_rl.proof.transfer.plan import Trained, TransferConfig
from buggy_rl.proof.transfer.score import losses
from buggy_rl.proof.transfer.tables import all_driven, read_tables, write_tables
from tests.proof.transfer.test_score import CLOSED, cars, rows

COMMAND = "python scripts/transfer.py configs/transfer.yaml"
ARMS = ["as_given", "repaired"]
LATE = {"steering_dead_time": {"dead_time": 0.08}}
SAID = {
    "verdict": "missing_physics",
    "effects": [
        {
            "name": "steering_dead_time",
            "parameters": {"dead_time": {"value": 0.0791}},
            "confidence": 0.97,
        }
    ],
}


@pytest.fixture
def config(tmp_path) -> TransferConfig:
    """A study of ten cars of which only the tables are left."""
    config = TransferConfig(str(tmp_path), cars=10, arms=list(CLOSED), seeds=[0, 1])
    rows().to_csv(tmp_path / "drives.csv", index=False)
    cars().to_csv(tmp_path / "cars.csv", index=False)
    return config


@pytest.fixture
def driven(tmp_path) -> TransferConfig:
    """A study of two cars with the files that its stages leave."""
    config = TransferConfig(str(tmp_path), cars=2, arms=ARMS, seeds=[0], control_every=2)

    def drive(arm, waypoints):
        rest = {"arm": arm, "seed": 0, "course": "lap", "minutes": 0.5}
        return rest | {"waypoints": waypoints, "lateral_mean": 0.0412345, "put_back": 1.0}

    for car in config.names:
        for arm in ARMS:
            write_json(config.driven(car, arm), {"asked": {}, "drives": [drive(arm, 60.0)]})
            folder = config.folder(Trained(arm, car, 0))
            write_json(folder / "outcome.json", {"status": "done", "seconds": 18.5})
        there = [drive("as_given", 31.0), drive("repaired", 55.0)]
        write_json(config.driven(car), {"asked": {}, "drives": there})
    write_atomically(config.answer("01"), json.dumps(SAID))
    drawn = config.drawn("a secret")
    write_tables(config, {**drawn, "01": replace(drawn["01"], concealed=LATE)})
    return config


def test_tables_hold_every_drive_a_minute_with_the_cost_of_its_training(driven):
    drives, cars = read_tables(driven.car("01").parents[1])
    assert len(drives) == 2 * 2
    row = drives[(drives.car == "01") & (drives.arm == "repaired")].iloc[0]
    assert (row.own, row.there, row.put_back, row.lateral) == (120.0, 110.0, 2.0, 0.0412)
    assert (row.steps, row.seconds) == (240_000, 18.5)
    first, second = cars.to_dict("records")
    assert first["concealed"] == "steering_dead_time dead_time 0.08"
    assert first["named"] == "steering_dead_time dead_time 0.0791 (97 %)"
    assert (second["concealed"], second["verdict"]) == ("", "not diagnosed")


def test_a_part_of_the_study_replaces_rows_of_its_own_cars_alone(driven):
    folder = driven.car("01").parents[1]
    whole = (folder / "drives.csv").read_text()
    assert all_driven(driven)
    for car in driven.names:  # drives of the first are here no more, the second drove anew
        driven.driven(car).unlink()
    there = {"seed": 0, "course": "lap", "minutes": 0.5, "lateral_mean": 0.5, "put_back": 1.0}
    anew = [{"arm": arm, "waypoints": 7.0, **there} for arm in ARMS]
    write_json(driven.driven("02"), {"asked": {}, "drives": anew})
    write_tables(replace(driven, only=[2]), driven.drawn("a secret"))
    drives, known = read_tables(folder)
    assert known.concealed.tolist() == ["steering_dead_time dead_time 0.08", ""]
    assert drives[drives.car == "02"].there.tolist() == [14.0, 14.0]
    first = [line for line in whole.splitlines() if line.startswith("01")]
    assert (folder / "drives.csv").read_text().splitlines()[1:3] == first
    assert not all_driven(replace(driven, cars=3))


def test_page_and_figure_are_made_again_from_the_tables_alone_to_the_last_byte(config, tmp_path):
    page = write_page(config, COMMAND)
    files = [page, tmp_path / "transfer.png"]
    first = [file.read_bytes() for file in files]
    assert first[1].startswith(b"\x89PNG")
    for file in files:
        file.unlink()
    write_page(config, COMMAND)
    assert [file.read_bytes() for file in files] == first


def test_without_tables_there_is_no_page(tmp_path):
    with pytest.raises(ValueError, match=r"no .*drives.csv: run the stages before page"):
        write_page(TransferConfig(str(tmp_path)), COMMAND)


def test_the_page_says_all_of_it(config):
    text = transfer_page(config, rows(), cars(), COMMAND)
    assert "8 cars in which something is concealed and 2 with nothing wrong" in text
    assert text.count("Met:") == 2
    assert text.count("**Not met**:") == 1
    # Own, on the car, lost, on controls, corrected (test_score has the working). Means of eight
    # cars drawn with replacement are eighths apart, with an sd of 0.66.
    assert "| as_given | 100.0 | 40.0 (38.8 to 41.2) | 60.0 | 15.0 | 45.0 (" in text
    assert "| learned | 20.0 (20.0 to 20.0) | 0.0078 | -12.0 (" in text
    assert "8 of 8 cars lose less repaired than as given. Car " in text
    assert "| 01 | 40 (100) | 80 (100) |" in text
    assert "| 01 | wind force_x 0.2 | missing physics | wind force_x 0.2 (97 %) |" in text
    assert "| 09 | nothing |" in text


def test_the_figure_has_a_column_for_each_arm_and_a_row_for_each_car():
    figure = transfer_figure(losses(rows(), cars()), cars())
    titles = [axis.get_title().replace("\n", "_") for axis in figure.axes]
    assert titles == list(CLOSED)
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels[0] == "wind 01"
    assert labels[-1] == "nothing 10"
    plt.close(figure)
