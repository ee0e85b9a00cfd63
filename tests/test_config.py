import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from buggy_rl.config import ConfigError, build, describe, from_plain, plain


@dataclass(frozen=True)
class Inner:
    rate: float = 1e-3
    """How fast."""


@dataclass(frozen=True)
class Outer:
    name: str = "car"
    inner: Inner = field(default_factory=Inner)


def test_later_arguments_win_over_earlier_ones(tmp_path: Path):
    file = tmp_path / "a.yaml"
    file.write_text("name: yaml\ninner: {rate: 0.5}\n")
    assert build(Outer, [str(file), "inner.rate=2e-3"]) == Outer("yaml", Inner(2e-3))


def test_an_unknown_key_is_refused_with_the_nearest_known_one():
    with pytest.raises(ConfigError, match="did you mean 'rate'"):
        build(Outer, ["inner.rat=1"])


def test_a_value_of_the_wrong_type_is_refused():
    with pytest.raises(ConfigError, match="fast"):
        build(Outer, ["inner.rate=fast"])


def test_a_missing_file_is_named():
    with pytest.raises(ConfigError, match=r"no\.yaml"):
        build(Outer, ["no.yaml"])


def test_help_shows_key_default_and_meaning_of_every_option():
    lines = list(describe("buggy_rl.models.training:TrainingConfig"))
    assert any("batch_size=" in line for line in lines)
    assert all("\n      " in line for line in lines), "an option without a line that explains it"


def test_help_follows_a_class_that_a_package_hands_on(tmp_path, monkeypatch):
    # buggy_rl.task.paths hands PathConfig on: no class is defined there
    (tmp_path / "travels.py").write_text(
        "from dataclasses import dataclass, field\n"
        "from buggy_rl.task.paths import PathConfig\n"
        "@dataclass\n"
        "class Trip:\n"
        "    paths: PathConfig = field(default_factory=PathConfig)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    lines = list(describe("travels:Trip"))
    assert "  paths.kind='simplex'" in lines[0]
    assert not any("PathConfig" in line for line in lines)


def test_help_knows_every_option_down_to_plain_values():
    for schema in ("policy_run:PolicyRunConfig", "driver_tables:DriverTablesConfig"):
        text = "\n".join(describe(f"buggy_rl.{schema}"))
        assert "task.paths.kind='simplex'" in text
        assert "Config" not in text


def test_a_config_comes_back_from_its_plain_values():
    config = Outer("other", Inner(0.5))
    assert from_plain(Outer, plain(config), "policy.pt") == config
    with pytest.raises(ConfigError, match=r"policy\.pt: unknown key 'inner\.rat'"):
        from_plain(Outer, {"inner": {"rat": 1.0}}, "policy.pt")


@pytest.mark.parametrize("script", sorted(Path("scripts").glob("*.py")), ids=lambda p: p.name)
def test_help_answers_without_importing_torch(script: Path):
    code = (
        "import sys, runpy\n"
        f"sys.argv = [{str(script)!r}, '--help']\n"
        "try:\n    runpy.run_path(sys.argv[0], run_name='__main__')\n"
        "except SystemExit as stop:\n    assert not stop.code, stop.code\n"
        "assert 'torch' not in sys.modules and 'pandas' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout) > 100


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("runs: {MLP: {kind: mlp}}", r"unknown key 'runs\.MLP\.kind'; available: model, prep"),
        ("runs: [a, b]", "study.yaml"),
        ("data: {recordings: data/sample}", r"write \[one, two\]"),
        ("runs: {MLP: {preparations: [foo]}}", "expected one of"),
    ],
)
def test_likely_slips_in_a_study_are_named(tmp_path: Path, content: str, message: str):
    from buggy_rl.identification.study import StudyConfig

    file = tmp_path / "study.yaml"
    file.write_text(content)
    with pytest.raises(ConfigError, match=message):
        build(StudyConfig, [str(file)])
