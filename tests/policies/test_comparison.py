import pandas as pd
import pytest
import yaml

from buggy_rl.figures.models import comparison_figure
from buggy_rl.policies.evaluation.comparison import CompareConfig, compare_runs, is_cost, summary


def make_run(folder, values, **config):
    scalars = folder / "csv" / "scalars"
    scalars.mkdir(parents=True)
    (folder / "config.yaml").write_text(yaml.safe_dump({"output": str(folder), **config}))
    lines = "".join(f"{steps},{value}\n" for steps, value in values.items())
    (scalars / "waypoints.csv").write_text(lines)
    return str(folder)


@pytest.fixture
def config(tmp_path):
    small = [
        make_run(tmp_path / "a", {10: 1.0, 20: 5.0, 30: 3.0}, seed=0, ppo={"clip": 0.1}),
        make_run(tmp_path / "b", {10: 3.0, 20: 7.0}, seed=1, ppo={"clip": 0.1}),
    ]
    large = [make_run(tmp_path / "c", {10: 8.0, 20: 9.0}, seed=0, ppo={"clip": 0.2})]
    return CompareConfig(runs={"small": small, "large": large}, metrics=["waypoints"])


def test_final_and_best_values_are_means_over_runs(config):
    row = compare_runs(config).table.set_index("group").loc["small"]
    assert row["final_mean"] == 5.0  # (3 + 7) / 2
    assert row["final_sd"] == pytest.approx(8**0.5)  # sqrt((2^2 + 2^2) / 1)
    assert row["best_mean"] == 6.0  # (5 + 7) / 2
    assert (row["least_steps"], row["most_steps"]) == (20, 30)


def test_a_band_ends_with_the_shortest_run(config):
    band = compare_runs(config).bands["small", "waypoints"]
    assert band.index.tolist() == [10, 20]
    assert band["mean"].tolist() == [2.0, 6.0]


def test_only_options_that_differ_are_listed_without_seed_and_output(config):
    found = compare_runs(config).differences
    assert found.index.tolist() == ["ppo.clip"]
    assert found.loc["ppo.clip"].tolist() == ["0.1", "0.2"]


def test_groups_of_one_config_differ_in_nothing(config):
    small = config.runs["small"]
    same = CompareConfig(runs={"a": small[:1], "b": small[1:]}, metrics=["waypoints"])
    assert compare_runs(same).differences.empty


def test_a_folder_that_is_no_run_is_named(config, tmp_path):
    wrong = CompareConfig(runs={"x": [str(tmp_path / "none")]}, metrics=["waypoints"])
    with pytest.raises(ValueError, match="none"):
        compare_runs(wrong)


def test_nothing_to_compare_is_an_error():
    with pytest.raises(ValueError, match="name some"):
        compare_runs(CompareConfig())


def test_a_panel_shows_a_line_for_each_group(config):
    (axis,) = comparison_figure(compare_runs(config)).axes
    assert [line.get_label() for line in axis.lines] == ["small", "large"]
    assert axis.lines[0].get_ydata().tolist() == [2.0, 6.0]


def test_a_sweep_is_grouped_by_config_without_seed_and_output(config, tmp_path):
    found = compare_runs(CompareConfig(sweep=str(tmp_path), metrics=["waypoints"])).table
    assert found["group"].tolist() == ["ppo.clip=0.1", "ppo.clip=0.2"]
    assert found["runs"].tolist() == [2, 1]


@pytest.mark.parametrize(("metric", "best"), [("validation_loss", 3.0), ("validation_speed", 7.0)])
def test_the_best_loss_is_the_lowest(metric, best):
    log = pd.Series([5.0, 3.0, 7.0], index=[1, 2, 3])
    assert summary([log], is_cost(metric))["best_mean"] == best


def test_a_sweep_without_runs_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="none is a run"):
        compare_runs(CompareConfig(sweep=str(tmp_path)))


def test_runs_that_share_no_step_are_an_error(tmp_path):
    runs = [make_run(tmp_path / "a", {10: 1.0}), make_run(tmp_path / "b", {20: 1.0})]
    with pytest.raises(ValueError, match="no step of waypoints in common"):
        compare_runs(CompareConfig(runs={"x": runs}, metrics=["waypoints"]))
