"""The command `buggy-rl`: verbs, their help, and the configs that travel with the package."""

import shlex
import sys
from pathlib import Path

import pytest
import yaml

from buggy_rl import commands
from buggy_rl.commands import MODULES, command_line, in_verbs, main
from buggy_rl.core.config import CONFIGS, ConfigError, build, config_file
from buggy_rl.policies.training.run import PolicyRunConfig


@pytest.fixture(autouse=True)
def own_arguments(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["buggy-rl"])


def test_every_script_is_a_verb_and_every_verb_a_script(repository):
    scripts = sorted(file.stem for file in (repository / "scripts").glob("*.py"))
    modules = sorted(f.stem for f in Path(commands.__file__).parent.glob("[!_]*.py"))
    assert sorted(MODULES.values()) == scripts == modules


def test_without_a_verb_all_are_listed_with_what_they_do(capsys):
    main([])
    said = capsys.readouterr().out
    assert [verb for verb in MODULES if f"\n  {verb:18} " not in said] == []
    assert "Says where a simulator and drives differ" in said


def test_an_unknown_verb_names_the_nearest():
    with pytest.raises(SystemExit, match=r"^error: no verb 'diagnos'; did you mean 'diagnose'\?"):
        main(["diagnos"])


@pytest.mark.parametrize("verb", MODULES)
def test_the_help_of_a_verb_speaks_of_verbs(verb, capsys):
    main([verb, "--help"])
    said = capsys.readouterr().out
    assert f"buggy-rl {verb}" in said
    assert "python scripts/" not in said


def test_a_script_that_is_no_verb_keeps_its_name():
    text = "python scripts/train_models.py a; scripts/fit_mujoco.py; python scripts/mine.py"
    assert in_verbs(text) == "buggy-rl train a; buggy-rl fit; python scripts/mine.py"


def test_a_verb_runs_with_its_options_and_its_exit_code(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["check", str(tmp_path / "nowhere.csv")])
    assert stop.value.code == 2
    assert "0 recordings usable, 0.0 s; 1 refused" in capsys.readouterr().out


def test_the_command_line_is_said_as_it_was_typed(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["buggy-rl prove", "a.yaml", "stages=page"])
    assert command_line(without="stages=") == "buggy-rl prove a.yaml"
    monkeypatch.setattr(sys, "argv", ["scripts/prove.py", "a.yaml"])
    assert command_line() == "python scripts/prove.py a.yaml"


def test_a_command_is_written_as_every_shell_takes_it(monkeypatch):
    words = ["scripts/prove.py", "a.yaml", "stages=[page]"]
    monkeypatch.setattr(sys, "argv", words)
    assert command_line() == "python scripts/prove.py a.yaml 'stages=[page]'"
    assert shlex.split(command_line()) == ["python", *words]


def test_the_packages_configs_are_found_from_anywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("configs/ppo.yaml", "ppo.yaml"):
        assert config_file(name) == CONFIGS / "ppo.yaml"
        assert build(PolicyRunConfig, [name, "output=x"]).ppo.steps > 0


def test_a_file_of_ones_own_is_taken_before_the_packages(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("configs").mkdir()
    Path("configs/ppo.yaml").write_text(yaml.safe_dump({"seed": 77}))
    assert build(PolicyRunConfig, ["configs/ppo.yaml", "output=x"]).seed == 77


def test_a_config_that_is_nowhere_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"there is no config file configs/nowhere\.yaml"):
        build(PolicyRunConfig, ["configs/nowhere.yaml", "output=x"])
