"""The files of the car: written as a whole once runtime and training agree, else not at all."""

import json
import runpy
import subprocess
import sys

import numpy as np
import pytest
import torch

from buggy_rl.car.path import Waypoints, load_path
from buggy_rl.car.policy import Policy as Runtime
from buggy_rl.export import export as module
from buggy_rl.export.export import ExportConfig, export
from buggy_rl.export.parity import ParityError
from buggy_rl.policies.evaluation.drives import benchmark_paths
from buggy_rl.policies.training.actor_critic import load_policy
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.transforms.commands import LastAction
from tests.policies.export.made import policy_file, stack, task


class Uncompared(LastAction):
    """A transform of the user's own."""

    memory = "own"


class Doubling(Uncompared):
    """One that changes the command."""

    def _filtered(self, previous, asked):
        return 2 * asked


HERE = "tests.policies.export.test_export"


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Drives of 40 steps."""
    course = module._course
    monkeypatch.setattr(module, "_course", lambda *about: shortened(course(*about)))


def shortened(course):
    return type(course)(course.name, course.paths, 40)


def config(file, output, **options):
    return ExportConfig(str(file), str(output), random_steps=20, **options)


def run_script(repository, monkeypatch, *arguments):
    monkeypatch.chdir(repository)
    monkeypatch.setattr(sys, "argv", ["scripts/export_policy.py", "random_steps=20", *arguments])
    runpy.run_path("scripts/export_policy.py", run_name="__main__")


def test_the_script_writes_all_files_and_says_how_far_apart_they_were(
    tmp_path, repository, monkeypatch, capsys
):
    own = tmp_path / "own.csv"
    own.write_text("x,y\n0,0\n1,0\n2,0.5\n3,0.5\n")
    file = policy_file(tmp_path, stack(filter=("past_mean", {"width": 5})))
    (tmp_path / "run.json").write_text(json.dumps({"commit": "abc1234"}))
    output = tmp_path / "car" / "policy"
    run_script(repository, monkeypatch, f"policy={file}", f"output={output}", f"course=[lap,{own}]")
    assert {file.name for file in output.parent.iterdir()} == {
        "policy.npz", "policy.json", "policy.onnx", "lap.csv", "own.csv"
    }  # fmt: skip
    assert "infinity: observation" in capsys.readouterr().out
    about = json.loads((output.parent / "policy.json").read_text())
    assert about["training"]["commit"] == "abc1234"
    assert (about["training"]["seed"], about["training"]["simulator"]) == (7, "kinematic")
    assert about["control_period"] == 0.01
    assert about["sensing"][0] == {"name": "past_mean", "width": 5}
    assert about["sensing"][1]["high"] == [3.5, 3.5, 6.5]
    assert about["observation"]["numbers"][:4] == [
        {"name": "vx", "unit": "m/s"}, {"name": "vy", "unit": "m/s"},
        {"name": "yaw_rate", "unit": "rad/s"}, {"name": "x_1", "unit": "m"},
    ]  # fmt: skip
    assert {left["place"] for left in about["left_out"]} == {"rewards", "step_limit", "path_end"}
    assert about["parity"]["lap"]["steps"] == 40


def test_a_training_folder_without_its_note_is_said_to_have_none(tmp_path):
    file = policy_file(tmp_path, task())
    list(export(config(file, tmp_path / "policy")))
    about = json.loads((tmp_path / "policy.json").read_text())
    assert about["training"]["commit"] == "unknown: there is no run.json beside best.pt"


def test_the_onnx_model_is_the_network(tmp_path):
    onnx, runtime = (pytest.importorskip(name) for name in ("onnx", "onnxruntime"))
    file = policy_file(tmp_path, task())
    list(export(config(file, tmp_path / "policy")))
    model = onnx.load(tmp_path / "policy.onnx")
    assert [entry.version for entry in model.opset_import] == [11]
    session = runtime.InferenceSession(str(tmp_path / "policy.onnx"))
    observation = 3 * torch.randn(50, 23)
    (given,) = session.run(None, {"observation": observation.numpy()})
    policy, _ = load_policy(file)
    expected = policy.mean_layers(policy.scaling(observation)).numpy()
    assert np.abs(expected).max() > 0.5
    np.testing.assert_allclose(given, expected, atol=1e-5)


def test_nothing_is_written_where_runtime_and_training_differ(tmp_path, monkeypatch):
    see = Waypoints.see
    monkeypatch.setattr(
        Waypoints, "see", lambda self, x, y, yaw, out: see(self, x, y, yaw + 1e-3, out)
    )
    file = policy_file(tmp_path, task())
    with pytest.raises(ParityError, match="lap, step 0: observation y_1"):
        list(export(config(file, tmp_path / "car" / "policy")))
    assert not (tmp_path / "car").exists()


def test_a_transform_of_the_users_own_is_refused_by_name_with_the_remedy(tmp_path):
    file = policy_file(tmp_path, stack(command=(f"{HERE}:Uncompared", {})))
    with pytest.raises(ValueError, match=r"command: the car's runtime does not know Uncompared.*"
                                         r"training_only=\[command\]"):  # fmt: skip
        list(export(config(file, tmp_path / "policy")))


def test_it_is_left_out_on_request_and_still_compared(tmp_path):
    harmless = policy_file(tmp_path / "a", stack(command=(f"{HERE}:Uncompared", {})))
    list(export(config(harmless, tmp_path / "a" / "policy", training_only=["command"])))
    about = json.loads((tmp_path / "a" / "policy.json").read_text())
    assert {"place": "command", "name": "Uncompared", "why": "named in training_only"} in about[
        "left_out"
    ]
    doubling = policy_file(tmp_path / "b", stack(command=(f"{HERE}:Doubling", {})))
    with pytest.raises(ParityError, match=r"throttle|steering"):
        list(export(config(doubling, tmp_path / "b" / "policy", training_only=["command"])))


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({}, {"training_only": ["brakes"]}, "no place brakes in the task; it has last_action"),
        ({}, {"course": ["oval"]}, "course='oval': must be one of lap, infinity, random"),
        (
            {"observation": ("observation", {"inputs": ["waypoints", "pose"]})},
            {},
            "observation: the car has no pose; train with inputs out of heading_error",
        ),
    ],
)
def test_what_cannot_be_exported_is_refused(tmp_path, change, options, message):
    file = policy_file(tmp_path, stack(**change))
    with pytest.raises(ValueError, match=message):
        list(export(config(file, tmp_path / "policy", **options)))


def test_a_policy_of_a_car_with_reverse_is_compared_and_says_that_it_stops_by_0(tmp_path):
    simulator = tmp_path / "brakes.yaml"
    simulator.write_text("engine: kinematic\noptions: {command: throttle_brake_reverse}\n")
    filters = {"limit": ["rate_limit"], "smoothing": ["action_smoothing"]}
    file = policy_file(tmp_path, stack(**filters), str(simulator))
    list(export(config(file, tmp_path / "policy")))  # its filters begin at 0, as in training
    runtime = Runtime.load(str(tmp_path / "policy.json"))
    assert runtime.two_way
    assert "0 is no drive" in runtime.settings["action"]["throttle"]["meaning"]


@pytest.mark.parametrize("name", ["lap", "infinity", "random", "training"])
def test_a_course_is_read_back_with_the_tables_of_training(tmp_path, name):
    paths = make_paths(benchmark_paths(PathConfig(waypoints=80), 1)[name].paths)
    course = module.ExportPath(name, paths, 1)
    module.write_path(tmp_path / "course.csv", course.for_car)
    read = load_path(str(tmp_path / "course.csv"))
    assert read.closed == bool(paths.closed[0])
    tables = read.tables(11)
    points = paths.extended(11)
    assert np.array_equal(tables.points, points[0].numpy())
    bit = 1.2e-7  # relative: a processor without fused multiply-add rounds the last one otherwise
    np.testing.assert_allclose(tables.tangents, paths.tangents(11)[0].numpy(), rtol=bit)
    chord = torch.cat([paths.before(), points], 1).diff(dim=1)[0]
    np.testing.assert_allclose(tables.length, chord.norm(dim=-1).numpy(), rtol=bit)


def test_an_exported_policy_drives_from_its_files_alone(tmp_path):
    file = policy_file(tmp_path, task())
    list(export(config(file, tmp_path / "policy", course=["lap"])))
    runtime = Runtime.load(str(tmp_path / "policy.json"))
    runtime.reset(load_path(str(tmp_path / "lap.csv")))
    throttle, steering = runtime.step((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    assert -1 <= throttle <= 1
    assert -1 <= steering <= 1


def test_help_answers_without_torch(repository):
    command = [sys.executable, "-X", "importtime", "scripts/export_policy.py", "--help"]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True)
    assert "tolerance=1e-05" in done.stdout
    assert "torch" not in done.stderr
