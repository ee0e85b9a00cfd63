"""A diagnosis that cannot read what is sealed: by the kernel, and in all that it starts."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from buggy_rl.jobs import read_outcome, run_jobs
from buggy_rl.proof import confined, running
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import publish, seal
from buggy_rl.proof.cases.secret import secret_of
from buggy_rl.proof.running import SealedRun, asked, diagnoses, diagnosis_job

ROOT = Path(__file__).parents[2]
CASES = [Case(n, "reference", "reference", bool(n), seconds=1.2) for n in range(2)]
TOOL = """
import json, os, pathlib, subprocess, sys, tempfile
output = pathlib.Path(sys.argv[2].removeprefix("output="))
paths = json.loads(os.environ["TRIED"])
code = "import sys; open(sys.argv[1], 'rb').read(1)"

def tried(path):
    try:
        open(path, "rb").read(1)
    except OSError as error:
        return type(error).__name__
    return "read"

def tried_by_child(path):
    done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True)
    return done.stderr.strip().splitlines()[-1].split(":")[0] if done.returncode else "read"

with tempfile.NamedTemporaryFile("w+") as file:
    file.write("kept")
    file.flush()
    kept = open(file.name).read()
found = {path: [tried(path), tried_by_child(path)] for path in paths}
found |= {"kept": kept, "listed": sorted(os.listdir(os.environ["LISTED"]))}
(output / "found.json").write_text(json.dumps(found))
(output / "diagnosis.json").write_text(json.dumps({"verdict": "no_mismatch", "effects": []}))
os.replace(output / "found.json", pathlib.Path("moved.json"))
"""

landlock = pytest.mark.skipif(bool(confined.missing()), reason=confined.missing() or "there")


@pytest.fixture
def config(tmp_path) -> SealedRun:
    """Two cases, sealed, with a ledger elsewhere."""
    made = SealedRun(
        output=str(tmp_path / "out"),
        sealed=str(tmp_path / "sealed"),
        ledger=str(tmp_path / "ledger.jsonl"),
        workers=1,
    )
    store = made.store
    for folder in (store.output, store.sealed, store.prepared):
        folder.mkdir(parents=True)
    secret = secret_of(store)
    publish(store, CASES, secret)
    seal(store, CASES, [], secret)
    made.lines.file.write_text("")
    (store.prepared / "drive_0.csv").write_text("t,x\n")
    (tmp_path / "tool.py").write_text(TOOL)
    return made


@landlock
def test_what_is_sealed_cannot_be_read_and_its_own_folder_can(config, tmp_path, monkeypatch):
    store, [own, other] = config.store, CASES
    hidden = [
        store.truth(own.id),
        store.held_out(own.id) / "drive_2.csv",
        store.sealed / "secret.txt",
        store.prepared / "drive_0.csv",
        store.inputs(other.id) / "recordings" / "drive_0.csv",
        store.hashes,
        config.lines.file,
        Path(running.__file__),
        Path(running.__file__).parent / "cases" / "draw.py",
    ]
    assert all(path.exists() for path in hidden)
    inputs = store.inputs(own.id)
    seen = [inputs / "question.yaml", inputs / "recordings" / "drive_0.csv", tmp_path / "tool.py"]
    seen += [Path(json.__file__), ROOT / "src" / "buggy_rl" / "diagnosis" / "pipeline.py"]
    (tmp_path / "link.csv").symlink_to(hidden[0])
    hidden.append(tmp_path / "link.csv")
    monkeypatch.setenv("TRIED", json.dumps([*map(str, hidden), *map(str, seen)]))
    monkeypatch.setenv("LISTED", str(store.sealed))
    step = diagnoses(config, "diagnosing", [own.id], tmp_path / "tool.py")
    assert list(step.results) == [(1, "")]
    found = json.loads((inputs / "moved.json").read_text())
    for path in hidden:
        assert found[str(path)] == ["PermissionError", "PermissionError"], path
    for path in seen:
        assert found[str(path)] == ["read", "read"], path
    assert found["kept"] == "kept"
    # Names are seen: they are numbers of cases, and tell nothing.
    assert found["listed"] == ["0000000", "0000000.json", "0000001", "0000001.json", "secret.txt"]
    [entry] = asked(store, [own])
    assert entry.made["confined"] == "landlock"


@landlock
def test_a_run_in_the_open_says_so(config, tmp_path, monkeypatch):
    openly = SealedRun(**{**vars(config), "confine": False})
    store = openly.store
    monkeypatch.setenv("TRIED", json.dumps([str(store.truth(CASES[0].id))]))
    monkeypatch.setenv("LISTED", str(store.sealed))
    list(diagnoses(openly, "diagnosing", [CASES[0].id], tmp_path / "tool.py").results)
    found = json.loads((store.inputs(CASES[0].id) / "moved.json").read_text())
    assert found[str(store.truth(CASES[0].id))] == ["read", "read"]
    [entry] = asked(store, CASES)
    assert entry.made["confined"] == "no"


def test_where_nothing_can_be_confined_a_run_is_refused(config, monkeypatch):
    monkeypatch.setattr(confined, "missing", lambda: "darwin has no Landlock")
    with pytest.raises(ValueError, match=r"darwin has no Landlock: .* or give confine=false"):
        diagnoses(config, "diagnosing", [CASES[0].id], ROOT / "scripts" / "diagnose.py")


def test_on_another_system_there_is_no_landlock(monkeypatch):
    monkeypatch.setattr(sys, "platform", "darwin")
    assert confined.missing() == "darwin has no Landlock"


def test_a_kernel_that_refuses_the_call_has_none(monkeypatch):
    def refused(*_):
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(confined, "abi", refused)
    assert "Function not implemented" in confined.missing()


def test_every_entry_beside_the_way_to_what_is_hidden_may_be_read(tmp_path):
    for name in ("a/b/hidden", "a/c", "d", "a/b/hidden/shown"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "a" / "b" / "hidden")
    # The inner one is within the outer one: nothing beside it may be read.
    paths = [tmp_path / "a/b/hidden", tmp_path / "a/b/hidden/inner", tmp_path / "a/b/missing"]
    found = {*confined.readable(paths, [tmp_path / "a/b/hidden/shown"])}
    inside = {str(p.relative_to(tmp_path)) for p in found if p.is_relative_to(tmp_path)}
    assert inside == {"a/c", "d", "file", "a/b/hidden/shown"}
    assert not any(path.is_relative_to(found_) for path in paths for found_ in found)
    assert Path(sys.executable).resolve().parts[1] in {path.parts[1] for path in found}


def run(tmp_path, code: str) -> int:
    (tmp_path / "script.py").write_text(code)
    (tmp_path / "hidden").mkdir()
    command = [sys.executable, confined.__file__, "--hidden", str(tmp_path / "hidden")]
    return subprocess.run([*command, "--", str(tmp_path / "script.py")]).returncode


@landlock
@pytest.mark.parametrize(
    ("code", "ends"),
    [
        ("raise SystemExit(3)", 3),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", -signal.SIGKILL),
    ],
)
def test_it_ends_as_the_script_does(tmp_path, code, ends):
    assert run(tmp_path, code) == ends


@landlock
def test_a_script_without_hidden_paths_in_the_way_writes_and_moves_files(tmp_path):
    code = (
        "import os, pathlib\n"
        "here = pathlib.Path(__file__).parent\n"
        "(here / 'hidden' / 'new').write_text('x')\n"
        "(here / 'kept').mkdir()\n"
        "try:\n"
        "    os.replace(here / 'hidden' / 'new', here / 'kept' / 'new')\n"
        "    open(here / 'kept' / 'new').read()\n"
        "except OSError:\n"
        "    raise SystemExit(5)\n"
    )
    # What is hidden cannot be moved to where it could be read.
    assert run(tmp_path, code) == 5


@landlock
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_real_diagnosis_runs_confined(config, tmp_path):
    case = Case(5, "reference", "reference", seconds=12.0)
    store, effects = config.store, ["steering_gain", "viscous_drag"]
    publish(store, [case])
    seal(store, [case], effects)
    question = store.inputs(case.id) / "question.yaml"
    content = {**yaml.safe_load(question.read_text()), "minutes": 0.2, "workers": 2}
    question.write_text(yaml.safe_dump(content))
    list(diagnoses(config, "diagnosing", [case.id], ROOT / "scripts" / "diagnose.py").results)
    outcome = read_outcome(store.diagnosis(case.id))
    assert outcome["status"] == "done", outcome["last_words"]
    assert (store.diagnosis(case.id) / "report.html").exists()


@landlock
def test_a_time_limit_ends_the_script_and_leaves_no_temporary_folder(config, tmp_path):
    (tmp_path / "tool.py").write_text(
        "import os, pathlib, sys, time\n"
        "output = pathlib.Path(sys.argv[2].removeprefix('output='))\n"
        "(output / 'told').write_text(f'{os.getpid()} {os.environ[\"TMPDIR\"]}')\n"
        "time.sleep(60)\n"
    )
    store, id_ = config.store, CASES[0].id
    job = diagnosis_job(store, id_, tmp_path / "tool.py", 2.0, config.hidden)
    assert [p.outcome.status for p in run_jobs([job], 1) if p.outcome] == ["timed out"]
    process, temporary = (store.diagnosis(id_) / "told").read_text().split()
    assert not Path(temporary).exists()
    with pytest.raises(ProcessLookupError):
        os.kill(int(process), 0)
