import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from buggy_rl.core.config import ConfigError, belongs_to, build, from_plain, plain_values
from buggy_rl.core.option_values import describe


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
    lines = list(describe("buggy_rl.simulators.learned.training:TrainingConfig"))
    assert any("batch_size=" in line for line in lines)
    assert all("\n      " in line for line in lines), "an option without a line that explains it"


def test_help_follows_a_class_of_another_module(tmp_path, monkeypatch):
    (tmp_path / "travels.py").write_text(
        "from dataclasses import dataclass, field\n"
        "from buggy_rl.task.paths.making import PathConfig\n"
        "@dataclass\n"
        "class Trip:\n"
        "    paths: PathConfig = field(default_factory=PathConfig)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    lines = list(describe("travels:Trip"))
    assert "  paths.kind='simplex'" in lines[0]
    assert not any("PathConfig" in line for line in lines)


def test_help_knows_every_option_down_to_plain_values():
    for schema in (
        "training.run:PolicyRunConfig",
        "evaluation.controller_tables:DriverTablesConfig",
    ):
        text = "\n".join(describe(f"buggy_rl.policies.{schema}"))
        assert "task.paths.kind='simplex'" in text
        assert "Config" not in text


@dataclass(frozen=True)
class Part:
    name: str = "a"
    options: dict[str, Any] = field(
        default_factory=lambda: {"of_a": 1}, metadata=belongs_to("name")
    )


@dataclass(frozen=True)
class Machine:
    part: Part = field(default_factory=Part)
    parts: dict[str, Part] = field(default_factory=lambda: {"first": Part()})


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ([], {"of_a": 1}),
        (["part.name=a", "part.options.more=2"], {"of_a": 1, "more": 2}),
        (["part.name=b"], {}),
        (["part.name=b", "part.options.of_b=2"], {"of_b": 2}),
        (["part.options.of_b=2", "part.name=b"], {"of_b": 2}),
        (["{a_named}", "part.options.more=2"], {"of_a": 3, "more": 2}),
        (["{b_named}"], {"of_b": 3}),
        (["{b_named}", "part.options.more=2"], {"of_b": 3, "more": 2}),
        (["{b_named}", "part.name=a"], {}),
        (["part.options.of_a=4", "{b_named}"], {"of_b": 3}),
        (["{b_named}", "{a_named}"], {"of_a": 3}),
    ],
)
def test_options_of_a_name_go_with_it(tmp_path: Path, arguments, options):
    for name in ("a", "b"):
        file = tmp_path / f"{name}.yaml"
        entry = f"{{name: {name}, options: {{of_{name}: 3}}}}"
        file.write_text(f"part: {entry}\nparts: {{first: {entry}}}\n")
    files = {"a_named": tmp_path / "a.yaml", "b_named": tmp_path / "b.yaml"}
    given = [argument.format(**files) for argument in arguments]
    assert build(Machine, given).part.options == options
    nested = [a.replace("part.", "parts.first.", 1) if "=" in a else a for a in given]
    assert build(Machine, nested).parts["first"].options == options


def test_a_saved_config_has_no_options_of_the_default_name():
    saved = {"part": {"name": "b", "options": {"of_b": 5}}}
    assert from_plain(Machine, saved, "policy.pt").part.options == {"of_b": 5}


def test_a_model_of_another_kind_starts_from_its_own_options(tmp_path: Path):
    from buggy_rl.estimation.fit_study import StudyConfig

    file = tmp_path / "study.yaml"
    file.write_text("output: x\nruns: {net: {model: {kind: mlp, options: {rows: 6}}}}\n")
    arguments = [str(file), "data.recordings=[x]", "runs.net.model.kind=gru"]
    assert build(StudyConfig, arguments).runs["net"].model.options == {}
    assert build(StudyConfig, arguments[:2]).runs["net"].model.options == {"rows": 6}


def test_another_simulator_drops_the_options_of_the_first(tmp_path: Path):
    from buggy_rl.policies.training.run import PolicyRunConfig

    file = tmp_path / "mujoco.yaml"
    file.write_text(
        "output: x\nengine: {simulator: mujoco, parameters: {mass: 1.7}, options: {nthread: 2}}\n"
    )
    config = build(PolicyRunConfig, [str(file), "engine.simulator=kinematic"])
    assert (config.engine.parameters, config.engine.options) == ({}, {})


def test_a_config_comes_back_from_its_plain_values():
    config = Outer("other", Inner(0.5))
    assert from_plain(Outer, plain_values(config), "policy.pt") == config
    with pytest.raises(ConfigError, match=r"policy\.pt: unknown key 'inner\.rat'"):
        from_plain(Outer, {"inner": {"rat": 1.0}}, "policy.pt")


HELP = """
import contextlib, io, pathlib, runpy, sys
for script in sorted(map(str, pathlib.Path("scripts").glob("*.py"))):
    sys.argv = [script, "--help"]
    with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.suppress(SystemExit):
        runpy.run_path(script, run_name="__main__")
    assert "torch" not in sys.modules and "pandas" not in sys.modules, script
    print(script, len(said.getvalue()))
"""


def test_help_answers_without_importing_torch():
    done = subprocess.run([sys.executable, "-c", HELP], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lengths = dict(line.split() for line in done.stdout.splitlines())
    assert {script.name for script in Path("scripts").glob("*.py")} == {
        Path(s).name for s in lengths
    }
    assert all(int(length) > 100 for length in lengths.values())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("runs: {MLP: {kind: mlp}}", r"unknown key 'runs\.MLP\.kind'; available: model, prep"),
        ("runs: [a, b]", "study.yaml"),
        ("data: {recordings: {a: data/sample}}", r"write \[one, two\]"),
        ("runs: {MLP: {preparations: [foo]}}", "expected one of"),
    ],
)
def test_likely_slips_in_a_study_are_named(tmp_path: Path, content: str, message: str):
    from buggy_rl.estimation.fit_study import StudyConfig

    file = tmp_path / "study.yaml"
    file.write_text(content)
    with pytest.raises(ConfigError, match=message):
        build(StudyConfig, [str(file)])


def test_an_option_that_a_class_declares_anew_is_described_once():
    lines = list(describe("buggy_rl.diagnosis.run.fleet:FleetConfig"))
    options = [line.split("=")[0].strip() for line in lines]
    assert len(options) == len(set(options))
    assert next(line for line in lines if line.startswith("  recordings=")).startswith(
        "  recordings=[]"
    )
    assert {"launcher", "cars", "stretches"} <= set(options)


@dataclass(frozen=True)
class Lists:
    paths: list[str] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    file: str = ""
    columns: str | None = None
    data: dict[str, Outer] = field(default_factory=dict)


@pytest.mark.parametrize(
    ("text", "items"),
    [
        ("drives", ["drives"]),
        ("[drives]", ["drives"]),
        ("a.csv,b.csv", ["a.csv", "b.csv"]),
        ("[a.csv, b.csv]", ["a.csv", "b.csv"]),
        ("rec/d[1].csv", ["rec/d[1].csv"]),
        ("[rec/d[1].csv,rec/d[2].csv]", ["rec/d[1].csv", "rec/d[2].csv"]),
        ("rec/drive #1.csv", ["rec/drive #1.csv"]),
        ("[rec/drive #1.csv, b: c.csv]", ["rec/drive #1.csv", "b: c.csv"]),
        ("""["drive 1, fast.csv",'it''s.csv',c.csv]""", ["drive 1, fast.csv", "it's.csv", "c.csv"]),
        ("", []),
        ("[]", []),
        ("[true,1e3]", ["true", "1e3"]),
    ],
)
def test_a_list_of_names_needs_no_brackets_and_takes_any_character(text, items):
    assert build(Lists, [f"paths={text}"]).paths == items


@pytest.mark.parametrize("text", ["0", "[0]"])
def test_a_list_of_numbers_needs_no_brackets(text):
    assert build(Lists, [f"numbers={text}"]).numbers == [0]
    assert build(Lists, ["numbers=0,1,2"]).numbers == [0, 1, 2]


def test_a_file_with_a_comma_in_its_name_is_one_item_or_refused_with_the_quotes(tmp_path: Path):
    name = str(tmp_path / "drive 1, fast.csv")
    Path(name).write_text("")
    (tmp_path / "other.csv").write_text("")
    for text in (name, f"[{name}]", f'["{name}"]'):
        assert build(Lists, [f"paths={text}"]).paths == [name]
    both = f"{tmp_path}/other.csv, {name}"
    with pytest.raises(ConfigError, match=r"""a comma in its name: put it in quotes.*key=\[\"/"""):
        build(Lists, [f"paths=[{both}]"])
    quoted = build(Lists, [f'paths=[{tmp_path}/other.csv,"{name}"]'])
    assert quoted.paths == [f"{tmp_path}/other.csv", name]


def test_a_list_that_the_shell_has_split_is_refused_with_the_quotes():
    with pytest.raises(ConfigError, match=r"paths: no \] at the end of '\[rec/drive': put the"):
        build(Lists, ["paths=[rec/drive", "1.csv]"])


def test_a_text_is_taken_as_it_stands():
    taken = build(Lists, ["file=runs/a #1", "columns=on", "data.a.name=1e3"])
    assert (taken.file, taken.columns, taken.data["a"].name) == ("runs/a #1", "on", "1e3")
    assert build(Lists, ["file='runs/a'", "columns=null"]) == Lists(file="runs/a", columns=None)


def test_a_single_value_in_a_file_is_a_list_of_one(tmp_path: Path):
    file = tmp_path / "a.yaml"
    file.write_text("paths: drives\nnumbers: 3\n")
    assert build(Lists, [str(file)]) == Lists(["drives"], [3])


def test_a_key_that_belongs_to_a_part_is_found_there():
    with pytest.raises(ConfigError, match=r"unknown key 'rate'; did you mean 'inner\.rate'\?"):
        build(Outer, ["rate=1"])


def test_a_misspelt_effect_is_refused_without_importing_torch():
    code = (
        "import sys, runpy\n"
        "sys.argv = ['scripts/diagnose.py', 'simulator=a.yaml', 'recordings=drives',"
        " 'output=runs/x', 'effects=payload,steering_deadtime']\n"
        "try:\n    runpy.run_path(sys.argv[0], run_name='__main__')\n"
        "except SystemExit as stop:\n    print(stop.code)\n"
        "assert 'torch' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    [line] = done.stdout.splitlines()
    assert "no effect 'steering_deadtime'; did you mean 'steering_dead_time'?" in line


def test_a_value_that_is_left_open_in_a_file_is_asked_for():
    with pytest.raises(ConfigError, match=r"map\.yaml: needed but not given: inner\.rate"):
        from_plain(Outer, {"inner": {"rate": "???"}}, "map.yaml")
