import pandas as pd
import pytest

from buggy_rl.policies.training.seeds import ShowLearningConfig, band, curves, read_log


def run(folder, training, validation):
    """A folder of logs, {steps: value} of both metrics."""
    scalars = folder / "csv" / "scalars"
    scalars.mkdir(parents=True)
    for name, values in (("waypoints", training), ("validation_waypoints", validation)):
        lines = "".join(f"{steps},{value}\n" for steps, value in values.items())
        (scalars / f"{name}.csv").write_text(lines)
    return str(folder)


@pytest.fixture
def runs(tmp_path):
    first = run(tmp_path / "a", {10: "nan", 20: 4.0, 30: 6.0}, {30: 7.0})
    second = run(tmp_path / "b", {10: 1.0, 20: 8.0, 30: 7.0, 40: 9.0}, {30: 9.0})
    return [first, second]


@pytest.fixture
def drivers(tmp_path):
    file = tmp_path / "drivers.csv"
    file.write_text(
        "driver,course,waypoints\npure_pursuit,training,5.5\npure_pursuit,validation,6.5\n"
        "stanley,training,4\n"
    )
    return str(file)


def test_a_band_is_over_the_steps_that_all_runs_have():
    table = band([pd.Series({20: 4.0, 30: 6.0}), pd.Series({10: 1.0, 20: 8.0, 30: 7.0})])
    assert table.index.tolist() == [20, 30]
    assert table["mean"].tolist() == [6.0, 6.5]
    assert table["low"].tolist() == [4.0, 6.0]
    assert table["high"].tolist() == [8.0, 7.0]


def test_episodes_that_have_not_ended_yet_are_left_out(runs, tmp_path):
    assert read_log(tmp_path / "a", "waypoints").to_dict() == {20: 4.0, 30: 6.0}


def test_curves_are_those_of_every_kind_on_training_and_validation_paths(runs, drivers):
    found = curves(ShowLearningConfig(runs={"x": runs, "y": runs[:1]}, drivers={"x": drivers}))
    assert [(c.name, c.metric, c.runs, c.score) for c in found] == [
        ("x", "waypoints", 2, 5.5),
        ("x", "validation_waypoints", 2, 6.5),
        ("y", "waypoints", 1, None),
        ("y", "validation_waypoints", 1, None),
    ]
    assert found[1].band["mean"].tolist() == [8.0]


@pytest.mark.parametrize(
    ("runs_", "drivers_", "message"),
    [
        ({}, {}, "no run to show"),
        ({"x": ["nowhere"]}, {}, "there is no log nowhere"),
        ({"x": []}, {"z": "t.csv"}, r"drivers=\['z'\]: the runs are x"),
    ],
)
def test_what_is_not_there_is_named(runs_, drivers_, message):
    with pytest.raises(ValueError, match=message):
        curves(ShowLearningConfig(runs=runs_, drivers=drivers_))


def test_a_table_without_the_driver_is_refused(runs, tmp_path):
    file = tmp_path / "drivers.csv"
    file.write_text("driver,course,waypoints\nstanley,training,4\n")
    with pytest.raises(ValueError, match="0 rows of pure_pursuit on training"):
        curves(ShowLearningConfig(runs={"x": runs}, drivers={"x": str(file)}))
    with pytest.raises(ValueError, match=r"there is no table .*lost\.csv"):
        curves(ShowLearningConfig(runs={"x": runs}, drivers={"x": str(tmp_path / "lost.csv")}))
