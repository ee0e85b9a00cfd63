"""Policies driven on the car and in their own simulators."""

import json
from dataclasses import replace

import pytest
import torch

from buggy_rl.core.config import build, plain_values
from buggy_rl.policies.training.actor_critic import Policy, PolicyConfig, save_policy
from buggy_rl.policies.training.run import PolicyRunConfig
from buggy_rl.proof.transfer import driving
from buggy_rl.proof.transfer.driving import (
    ENDLESS,
    PolicyBatch,
    batches,
    drive_policies,
    drive_rows,
    undriven,
)
from buggy_rl.proof.transfer.plan import TransferConfig

pytestmark = pytest.mark.slow

OBSERVED = 23  # velocity, and ten waypoints


def policy_file(folder, seed, throttle):
    """A policy nobody has trained, that goes straight on at a throttle."""
    torch.manual_seed(seed)
    policy = Policy(OBSERVED, PolicyConfig(hidden=[8]))
    last = policy.mean_layers[-1]
    assert isinstance(last, torch.nn.Linear)
    with torch.no_grad():
        last.bias.copy_(torch.tensor([throttle, 0.0]))
    config = plain_values(build(PolicyRunConfig, ["output=x"]))
    folder.mkdir(parents=True, exist_ok=True)
    save_policy(policy, folder / "best.pt", {"config": config})
    return str(folder / "best.pt")


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> list[str]:
    folder = tmp_path_factory.mktemp("policies")
    return [policy_file(folder / str(n), n, throttle) for n, throttle in enumerate((-0.6, 0.0))]


def judged(files, **changes) -> PolicyBatch:
    policies = tuple((f"arm{n}", n, file) for n, file in enumerate(files))
    judged = PolicyBatch(TransferConfig("none").driven("x"), "single_track", None, policies, 1.5, 2)
    return replace(judged, **changes)


@pytest.fixture
def endless(monkeypatch):
    """Leaves the path out that has an end, which is driven to it."""
    monkeypatch.setattr(driving, "ROOM", ENDLESS)


@pytest.mark.usefixtures("endless")
def test_each_policy_drives_as_if_it_were_alone(files):
    together = list(drive_rows(judged(files)))
    alone = [row for n in (0, 1) for row in drive_rows(judged(files[n : n + 1]))]
    assert [(r["arm"], r["course"]) for r in together[:2]] == [("arm0", "lap"), ("arm1", "lap")]
    for place, course in enumerate(ENDLESS):
        for n in (0, 1):
            one, other = together[2 * place + n], alone[len(ENDLESS) * n + place]
            assert one["course"] == other["course"] == course
            assert one["speed"] == pytest.approx(other["speed"], abs=1e-6)
            assert one["waypoints"] == other["waypoints"]
    assert together[0]["speed"] < together[1]["speed"]


def test_paths_without_an_end_are_driven_as_long_as_is_asked(files):
    minutes = {row["course"]: row["minutes"] for row in drive_rows(judged(files[:1]))}
    assert minutes["lap"] == minutes["infinity"] == pytest.approx(1.5 / 60)
    assert minutes["random"] == pytest.approx(5.0 / 60)


def test_a_car_that_stands_is_put_back_and_counted(files, tmp_path):
    standing = policy_file(tmp_path, 0, -1.0)
    times = {row["course"]: row["put_back"] for row in drive_rows(judged([standing], seconds=6.5))}
    # After 2 s, and every 4 s from then on: 2 s in hands, 2 s in vain.
    assert times == {"lap": 2.0, "infinity": 2.0, "random": 1.0}


def test_the_car_has_what_is_concealed_in_it_and_parameters_of_its_own(files):
    (case,) = TransferConfig("out", cars=1).drawn("a secret").values()

    def speed(case):
        return next(drive_rows(judged(files[1:], case=case, seconds=1.0)))["speed"]

    right = speed(replace(case, concealed={}))
    assert speed(replace(case, concealed={"throttle_gain": {"gain": 0.5}})) < 0.9 * right
    assert speed(replace(case, concealed={}, spread=0.0)) != right


@pytest.mark.usefixtures("endless")
def test_what_is_judged_is_not_judged_again_unless_it_is_something_else(files, tmp_path):
    one = judged(files[:1], file=tmp_path / "driven.json", seconds=0.3)
    assert not one.done
    assert drive_policies(one) == 1
    assert one.done
    assert len(json.loads(one.file.read_text())["drives"]) == len(ENDLESS)
    assert not replace(one, seconds=2.0).done
    assert not judged(files, file=one.file, seconds=0.3).done


@pytest.mark.usefixtures("endless")
def test_a_policy_that_is_trained_anew_is_judged_anew(tmp_path):
    one = judged([policy_file(tmp_path / "0", 0, -0.6)], file=tmp_path / "driven.json", seconds=0.1)
    drive_policies(one)
    assert one.done
    policy_file(tmp_path / "0", 0, 0.0)
    assert not one.done


def test_a_study_drives_every_arm_in_its_own_simulator_and_on_its_car(tmp_path):
    config = TransferConfig(str(tmp_path), cars=2, seeds=[0, 1], arms=["as_given", "randomised"])
    cases = config.drawn("a secret")
    found = {(str(b.file.relative_to(tmp_path))): b for b in batches(config, cases)}
    files = ("car", "as_given", "randomised")
    assert set(found) == {f"cars/{car}/driven/{f}.json" for car in cases for f in files}
    on_car = found["cars/02/driven/car.json"]
    assert on_car.case == cases["02"]
    assert [policy[:2] for policy in on_car.policies] == [
        (arm, seed) for arm in config.arms for seed in config.seeds
    ]
    assert all("cars/02/" in file for _, _, file in on_car.policies)
    assert found["cars/01/driven/randomised.json"].place.endswith("randomised.py:make")
    with pytest.raises(ValueError, match="8 policies are not trained yet"):
        undriven(config, cases)
    part = batches(replace(config, only=[2]), cases)
    assert [b.file for b in part] == [b.file for b in found.values() if "cars/02" in str(b.file)]
