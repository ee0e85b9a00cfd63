"""Something concealed for a person to find."""

import json
import subprocess
import sys

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.proof.blind_demo import FIRST, BlindDemoConfig, draw_case, position_error
from buggy_rl.task.env import make_simulator
from tests.running import ROOT


def test_the_same_seed_is_the_same_case(tmp_path):
    config = BlindDemoConfig(output=str(tmp_path / "demo"), seed=7)
    case = draw_case(config)
    assert case == draw_case(config)
    assert case.seed == FIRST + 7
    assert (case.plant, case.simulator, case.family) == ("reference", "reference", "one")


@pytest.mark.parametrize(("count", "family"), [(0, "nothing"), (2, "two"), (3, "three")])
def test_as_much_is_concealed_as_is_asked_for(tmp_path, count, family):
    config = BlindDemoConfig(output=str(tmp_path / "demo"), seed=1, effects=count)
    assert draw_case(config).family == family


def test_a_case_without_a_seed_is_new_until_one_is_there(tmp_path):
    config = BlindDemoConfig(output=str(tmp_path / "demo"))
    seeds = {draw_case(config).seed for _ in range(5)}
    assert len(seeds) == 5
    config.store.sealed.mkdir()
    config.store.truth(f"{FIRST + 123:07d}").write_text(json.dumps({}))
    assert draw_case(config).seed == FIRST + 123


def test_more_than_three_are_refused():
    with pytest.raises(ValueError, match="effects is 4: must be 0 to 3"):
        BlindDemoConfig(output="demo", effects=4)


def test_distance_is_between_places_at_that_time():
    measured = TensorDict({keys.POSE: torch.zeros(2, 4, 3)}, [2, 4])
    made = measured.clone()
    made[keys.POSE][0, 2, :2] = torch.tensor([0.3, 0.4])
    made[keys.POSE][:, 2, 2] = 1.0  # headings do not count
    # sqrt((0.25 + 0) / 2)
    assert position_error(made, measured, seconds=0.02) == pytest.approx(0.125**0.5)


@pytest.mark.slow
def test_a_case_is_sealed_diagnosed_and_revealed(tmp_path):
    options = [f"output={tmp_path / 'demo'}", "seed=3", "seconds=20", "more=[stretches=24]"]
    command = [sys.executable, "scripts/blind_demo.py", *options]
    first = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert first.returncode == 0, first.stderr
    assert "The sealed answer, unchanged" in first.stdout
    assert "[sensor_lag: time_constant 0.054]" in first.stdout
    assert (tmp_path / "demo" / "blind_demo.png").stat().st_size > 20_000
    file = first.stdout.rpartition("the simulator: ")[2].strip()
    assert [effect.name for effect in make_simulator(file, 2).transform] == ["sensor_lag"]
    # Nothing is driven or asked again.
    again = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert "screening" not in again.stderr
    assert again.stdout.splitlines()[-3:] == first.stdout.splitlines()[-3:]
