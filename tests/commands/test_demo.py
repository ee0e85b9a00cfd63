"""The demo: its stages, their order, and what is said of them; kernels compiled at first use."""

import re
import shlex
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path

import pytest

from buggy_rl.commands import MODULES, compile, demo
from buggy_rl.commands.demo import IN_FULL, KERNELS, SETTINGS, DemoStage, main, run_stages, stages
from buggy_rl.core import kernels as kernel
from buggy_rl.core.config import build, load_named
from buggy_rl.core.kernels import FOLDER
from buggy_rl.core.longitudinal import ONE_WAY_REST
from buggy_rl.effects import make_effects
from buggy_rl.effects.measuring import measurable_options
from buggy_rl.effects.tyre.change import changed_by
from buggy_rl.policies.training.run import PolicyRunConfig
from buggy_rl.task.env import make_simulator

ALL = stages("out")
DRIVE = "data/sample/sample_00.csv"
READ = ("buggy_rl.recordings", "buggy_rl.diagnosis.answer.other_sensors")  # once for all stages


@pytest.fixture(autouse=True)
def in_a_clone(repository, monkeypatch):
    monkeypatch.chdir(repository)


def tyres(of: str) -> list[str]:
    return [f"friction_change_{of}", f"slip_change_{of}"]


def config_of(module: str, arguments: list[str]):
    """The config that a command builds of its arguments; None of one that has none."""
    source = Path(import_module(f"buggy_rl.commands.{module}").__file__ or "").read_text()
    schema = re.search(r'"(buggy_rl\.[\w.]+:\w+)"', source)
    return build(load_named(schema[1]), arguments) if schema else None


@pytest.mark.parametrize("stage", ALL, ids=lambda stage: stage.name)
def test_every_stage_is_a_command_whose_options_are_taken(stage):
    config = config_of(MODULES[stage.verb], list(stage.arguments))
    assert (config is None) == (stage.verb == "check")
    if config is not None and stage.verb != "compile":
        assert config.output.startswith("out")
    assert stage.command.startswith(f"python scripts/{MODULES[stage.verb]}.py ")


def test_a_stage_needs_earlier_ones_alone():
    names = [stage.name for stage in ALL]
    assert len(set(names)) == len(names)
    for index, stage in enumerate(ALL):
        assert set(stage.needs) <= set(names[:index]), stage.name


@pytest.mark.parametrize(("what", "command"), IN_FULL)
def test_what_does_it_in_full_is_a_command_whose_options_are_taken(what, command):
    script, *arguments = shlex.split(command.format(output="demo"))
    config_of(
        script.removesuffix(".py"), [a.replace("[FOLDER]", "[data/sample]") for a in arguments]
    )


def test_the_demo_compiles_kernels_that_are_there_the_reference_cars_first():
    assert [k.name for k in kernel.kernels(KERNELS)] == list(KERNELS)
    assert KERNELS[0] == "reference_substep"


def test_both_policies_are_trained_by_the_same_settings():
    own = [build(PolicyRunConfig, s.arguments) for s in ALL if s.verb == "policy"]
    ours = build(PolicyRunConfig, ["configs/ppo.yaml", "output=demo"])
    assert len({c.engine.simulator for c in own}) == len(own) == 2
    for config in own:
        assert config.ppo.steps < ours.ppo.steps
        same = replace(config, engine=ours.engine, output=ours.output)
        assert replace(same, ppo=ours.ppo, validations=ours.validations) == ours
        assert replace(config.ppo, steps=ours.ppo.steps) == ours.ppo
    assert {*SETTINGS} < {*ALL[5].arguments}


def test_a_policy_that_was_begun_is_gone_on_with(tmp_path):
    (tmp_path / "policy_mujoco").mkdir()
    (tmp_path / "policy_mujoco" / "checkpoint.pt").touch()
    resumed = [s.name for s in stages(str(tmp_path)) if "resume=true" in s.arguments]
    assert resumed == ["policy mujoco"]


@pytest.mark.parametrize("given", [["a", "b"], ["--fast"], ["seed=3"]])
def test_what_the_demo_does_not_take_is_refused(given, monkeypatch):
    monkeypatch.setattr("sys.argv", ["scripts/demo.py", *given])
    with pytest.raises(ValueError, match="the demo takes one folder"):
        main()


def test_without_the_sample_drives_it_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["buggy-rl demo"])
    with pytest.raises(ValueError, match="no folder data/sample here"):
        main()


def test_stages_run_after_what_they_need_and_say_what_they_found(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(demo, "PRELOADED", READ)
    todo = [
        DemoStage("later", "Once more?", "check", (DRIVE,), ("first",)),
        DemoStage("first", "Is it fit?", "check", (DRIVE,)),
        DemoStage("fails", "Is there one?", "check", ("nowhere.csv",), (), "goes on without"),
    ]
    spent = run_stages(todo, tmp_path, 2)
    assert list(spent)[-1] == "later"
    assert {*spent} == {"first", "fails", "later"}
    assert all(seconds > 0 for seconds in spent.values())
    said = capfd.readouterr().out
    assert f"== Is it fit?\n   python scripts/check_recordings.py {DRIVE}\n" in said
    assert said.count("1 recordings usable, 40.0 s; 0 refused") == 2
    assert "nowhere.csv\n\ngoes on without\n" in said
    assert "usable" in (tmp_path / "log" / "first.out").read_text()


def test_a_stage_that_fails_ends_the_demo_with_its_last_words(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(demo, "PRELOADED", READ)
    todo = [
        DemoStage("fails", "Is there one?", "check", ("nowhere.csv",)),
        DemoStage("never", "Is it fit?", "check", (DRIVE,), ("fails",)),
    ]
    with pytest.raises(SystemExit, match="'Is there one\\?' did not finish"):
        run_stages(todo, tmp_path, 2)
    assert "0 recordings usable, 0.0 s; 1 refused" in capfd.readouterr().out
    assert not (tmp_path / "log" / "never.out").exists()


@pytest.fixture
def asked(tmp_path, monkeypatch) -> list[str]:
    """Kernels that are compiled, in place of compiling them, for an empty cache."""
    names: list[str] = []

    def compiled(missing, folder, workers):
        assert folder == tmp_path
        names.extend(missing)
        yield from missing

    monkeypatch.delenv(FOLDER, raising=False)
    monkeypatch.setenv("CXX", "sh")  # a program that is there
    monkeypatch.setattr(kernel, "CACHE", tmp_path)
    monkeypatch.setattr(compile, "compiled", compiled)
    return names


def test_a_diagnosis_compiles_what_it_steps_most_at_first_use_alone(asked, tmp_path, capfd):
    compile.at_first_use("reference")
    assert asked == ["reference_substep", *compile.OF_EFFECTS]
    assert "compiling 6 kernels, this once, some 15 s of a core each" in capfd.readouterr().err
    for k in kernel.kernels(asked):
        k.file(tmp_path).touch()
    compile.at_first_use("reference")
    assert len(asked) == 6
    compile.at_first_use("single_track")
    assert asked[6:] == ["single_track_substep"]


@pytest.mark.parametrize("variable", [FOLDER, "CXX"])
def test_where_a_folder_is_named_or_no_compiler_is_there_nothing_is_compiled(
    asked, variable, monkeypatch
):
    monkeypatch.setenv(variable, "/nowhere/at/all")
    compile.at_first_use("reference")
    assert asked == []


def test_a_compiler_that_refuses_is_told_and_pytorch_runs(asked, monkeypatch, capfd):
    def refused(*_):
        raise RuntimeError("no such instruction\nand more")

    monkeypatch.setattr(compile, "compiled", refused)
    compile.at_first_use("mujoco")
    said = capfd.readouterr()
    assert "not compiled, PyTorch runs, slower: no such instruction\n" in said.out + said.err


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("engine: reference\n", ["reference_substep", *compile.OF_EFFECTS]),
        (
            "engine: reference\noptions: {command: throttle_brake_reverse}\n",
            ["reference_substep_braked", *compile.OF_MOTION, *tyres("12_two_way")],
        ),
        ("engine: mujoco\n", ["mujoco_substep_rear_throttle", *compile.OF_EFFECTS]),
        ("engine: mujoco\noptions: {backend: cpu}\n", [*compile.OF_EFFECTS]),
        (
            "engine: single_track\nparameters: {front_drive_share: 0.5}\n"
            "options: {command: {kind: speed, reverse: true}}\n",
            ["single_track_substep", *compile.OF_MOTION, *tyres("02_two_way")],
        ),
        (
            "engine: single_track\nparameters: {front_drive_share: 1.0}\n",
            ["single_track_substep", *compile.OF_MOTION, *tyres("01")],
        ),
        ("engine: nowhere.py:make\n", [*compile.OF_EFFECTS]),
        ("- a list\n", [*compile.OF_EFFECTS]),
    ],
)
def test_the_kernels_are_those_of_the_car_of_a_file(tmp_path, text, names):
    (tmp_path / "simulator.yaml").write_text(text)
    assert compile.kernels_of(str(tmp_path / "simulator.yaml")) == names
    assert {*names} <= {kernel.name for kernel in kernel.kernels()}
    assert compile.kernels_of(str(tmp_path / "missing.yaml")) == [*compile.OF_EFFECTS]


@pytest.mark.parametrize("car", ["frictionmaps", "dart"])
def test_a_car_of_the_library_says_how_it_is_driven(car):
    make = partial(make_simulator, "single_track", car=car)
    options, _ = measurable_options(make)
    (effect,) = make_effects({"tire_grip": options["tire_grip"]})
    used = changed_by(effect._axles, effect.rest != ONE_WAY_REST).name
    assert used in compile.kernels_of("single_track", car=car)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_kernels_are_compiled_in_their_order_and_those_that_are_there_not_again(tmp_path, workers):
    names = ["moved", "centred"]
    for k in kernel.kernels(names):
        k.file(tmp_path).touch()
    assert sorted(compile.compiled(names, tmp_path, workers)) == sorted(names)
    assert [f.stat().st_size for f in tmp_path.glob("*.pt2")] == [0, 0]


def test_groups_of_kernels_are_kernels_that_there_are():
    for names in compile.GROUPS.values():
        assert [k.name for k in kernel.kernels(names)] == [*names]
