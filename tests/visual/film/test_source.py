"""What a user names: recordings, simulators, policies, drivers, and what is none of these."""

from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from buggy_rl.core.config import plain_values
from buggy_rl.policies.training.actor_critic import save_policy
from buggy_rl.policies.training.run import EngineConfig, PolicyRunConfig, new_policy
from buggy_rl.task.env import make_env
from buggy_rl.visual.film.options import RenderConfig
from buggy_rl.visual.film.source import RenderSource, kind_of, label

SAMPLE = str(Path(__file__).parents[3] / "data" / "sample" / "sample_00.csv")
OWN = """
from buggy_rl.simulators import make_engine

def factory(batch_size, device):
    return make_engine("kinematic", batch_size, device)
"""


def tracks(**options):
    return RenderSource(RenderConfig(seconds=0.5, **options)).tracks()


@pytest.fixture
def policy(tmp_path):
    """An untrained policy, with the record that training writes."""
    torch.manual_seed(0)
    config = PolicyRunConfig(output="x", engine=EngineConfig("kinematic"))
    env = make_env("kinematic", task=config.task, batch_size=1)
    file = tmp_path / "best.pt"
    save_policy(new_policy(env, config.policy), file, {"config": plain_values(config)})
    return str(file)


def test_a_recording_is_what_was_measured():
    (track,) = tracks(what=SAMPLE, start=1.0)
    assert track.name == "sample_00"
    assert track.duration == pytest.approx(0.5)
    assert track.course is None


def test_a_simulator_drives_under_the_commands_of_the_recording_beside_it():
    measured, simulated = tracks(what=SAMPLE, ghost="kinematic", start=3.0)
    np.testing.assert_allclose(simulated.pose[0], measured.pose[0], atol=1e-5)
    np.testing.assert_allclose(simulated.action, measured.action, atol=1e-6)
    assert not np.allclose(simulated.pose[-1], measured.pose[-1], atol=1e-5)
    ghost_first = tracks(what="kinematic", ghost=SAMPLE, start=3.0)
    np.testing.assert_array_equal(ghost_first[0].pose, simulated.pose)


def test_two_ghosts_have_the_names_they_are_given():
    given = ["measured", "as given", "repaired"]
    found = tracks(what=SAMPLE, ghost=["kinematic", "hold"], start=3.0, names=given)
    assert [track.name for track in found] == given
    assert not np.allclose(found[1].pose, found[2].pose)


def test_simulator_files_and_a_users_own_are_simulators(tmp_path):
    slow = tmp_path / "slow.yaml"
    slow.write_text(yaml.safe_dump(
        {"engine": "kinematic", "effects": {"steering_dead_time": {"dead_time": 0.05}}}
    ))  # fmt: skip
    own = tmp_path / "own.py"
    own.write_text(OWN)
    one, other = tracks(what=str(slow), ghost=f"{own}:factory", recording=SAMPLE, start=3.5)
    assert (one.name, other.name) == ("slow", "own.py:factory")
    assert not np.allclose(one.pose, other.pose)


def test_without_commands_pure_pursuit_drives_a_simulator_round_the_course():
    (track,) = tracks(what="kinematic", course="infinity")
    assert track.course is not None
    assert track.velocity[-1, 0] > 0.1


def test_a_policy_drives_its_own_simulator_and_pure_pursuit_the_same(policy):
    driven, compared = tracks(what=policy, ghost="pure_pursuit")
    assert driven.course is not None
    assert compared.course is not None
    np.testing.assert_array_equal(driven.course.points, compared.course.points)
    np.testing.assert_array_equal(driven.pose[0], compared.pose[0])
    assert not np.allclose(driven.action, compared.action)


def test_a_seed_repeats_a_drive(policy):
    once, again = (tracks(what=policy, seed=3)[0] for _ in range(2))
    np.testing.assert_array_equal(once.pose, again.pose)


def test_kinds_are_told_from_the_file(policy):
    kinds = [kind_of(name) for name in (SAMPLE, "mujoco", policy, "stanley", "my.py:factory")]
    assert kinds == ["recording", "simulator", "driver", "driver", "simulator"]


@pytest.mark.parametrize("name", ["nowhere.csv", "nowhere.pt", "nowhere.yaml"])
def test_a_file_that_is_not_there_is_named(name):
    with pytest.raises(ValueError, match=f"there is no file {name}"):
        kind_of(name)


def test_what_is_no_file_of_pytorch_is_refused(tmp_path):
    (tmp_path / "broken.pt").write_text("no")
    with pytest.raises(ValueError, match=r"broken\.pt is not a file of PyTorch"):
        kind_of(str(tmp_path / "broken.pt"))


def test_what_does_not_go_together_is_refused():
    with pytest.raises(ValueError, match="a driver follows a course and no recorded commands"):
        tracks(what="pure_pursuit", ghost=SAMPLE)
    with pytest.raises(ValueError, match=r"no engine 'mujjoco'; available"):
        tracks(what="mujjoco", recording=SAMPLE)
    with pytest.raises(ValueError, match="course='moon': must be one of"):
        tracks(what="kinematic", course="moon")


def test_labels_are_short_and_tell_files_apart():
    names = ["a/b/drive.yaml", "runs/one/best.pt", "mujoco", "x/my.py:factory"]
    assert [label(name) for name in names] == ["drive", "one/best", "mujoco", "my.py:factory"]


def test_a_driver_beside_a_simulator_drives_that_simulator():
    one, other = tracks(what="kinematic", ghost="pure_pursuit")  # pure pursuit in both
    np.testing.assert_array_equal(one.pose, other.pose)
    elsewhere = tracks(what="pure_pursuit", simulator="single_track")[0]
    assert (one.pose != elsewhere.pose).any()


def test_another_car_is_drawn_at_the_buggys_size_with_its_own_speed():
    from buggy_rl.core.car_file import load_car
    from buggy_rl.visual.film.film import director

    length = load_car("full_size").similarity.length
    config = RenderConfig(what="single_track", car="full_size", seconds=4.0)
    (track,) = RenderSource(config).tracks()
    says = director([track], config.picture)
    assert says.dimensions.wheelbase == pytest.approx(0.174)
    assert track.reduced == pytest.approx(length)
    assert np.linalg.norm(np.diff(track.course.points[:3], axis=0), axis=1) == pytest.approx(
        0.2, abs=0.01
    )
    shown = says.shot(3.9).cars[0].speed
    assert shown == pytest.approx(length * track.at(3.9)[1][0])
    assert shown > 3.0  # [m/s] a full-size car after 4 s
