"""The proof itself, small: sealed cases, diagnosed, scored, on the script's command line.

Short drives and a library of a few effects; configs/proof.yaml has the real ones. The small one is
run here with the least search; the other one has all stages, each in processes of its own,
and other methods.
"""

import json
from contextlib import nullcontext
from pathlib import Path

import pytest

from buggy_rl.jobs import run_jobs
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import CaseStore, publish, seal
from buggy_rl.proof.running import asked, diagnosis_job
from buggy_rl.proof.score.weighing import sealed_distance
from tests.proof.here import jobs_here
from tests.running import Done, run_script

CASES = (
    "draw.each=true", "draw.nothing=1", "draw.cases=2",
    "draw.pairings=[reference]", "draw.nuisances=[white]", "draw.driving=[rich]",
    "draw.names=[steering_gain]",
)  # fmt: skip
SIZES = {
    "small": (
        "draw.seconds=[4.0]", "rivals=1", "effects=[steering_gain,gyro_bias]",
        "stages=[prepare,seal,ask,again,weigh,settle,score,page]",
    ),
    "all_stages": (
        "draw.seconds=[12.0]", "rivals=2",
        "effects=[steering_gain,steering_offset,viscous_drag,gyro_bias,sensor_yaw]",
    ),
}  # fmt: skip


def prove(folder: Path, size: str) -> Done:
    sealed = Path(f"{folder}_sealed")
    sealed.mkdir(exist_ok=True)  # a secret put there is taken: the same cases in every run
    (sealed / "secret.txt").write_text("of the tests\n")
    with jobs_here() if size == "small" else nullcontext():
        return run_script("scripts/prove.py", f"output={folder}", *CASES, *SIZES[size])


@pytest.fixture(scope="module", params=list(SIZES))
def proof(request, tmp_path_factory) -> tuple[Path, Done, str]:
    folder = tmp_path_factory.mktemp("proof") / "run"
    return folder, prove(folder, request.param), request.param


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_what_is_concealed_is_found_and_nothing_where_nothing_is(proof):
    folder, done, _ = proof
    assert done.returncode == 0, done.stderr
    store = CaseStore(folder, Path(f"{folder}_sealed"))
    for case in map(store.sealed_case, store.digests()):
        answer = json.loads((store.diagnosis(case.id) / "diagnosis.json").read_text())
        assert {effect["name"] for effect in answer["effects"]} == set(case.truth)
        weighed = json.loads(store.oracle(case.id).read_text())
        repaired = store.diagnosis(case.id) / "repaired.yaml"
        delivered = weighed["stack"]["distance"]["stack"]
        assert sealed_distance(store, case, repaired) == pytest.approx(delivered, rel=1e-6)
        if not case.truth:
            assert "nats" not in weighed
            continue
        assert min(weighed["nats"], *weighed["rivals"].values()) > 10
        (effect,) = case.truth
        for name, value in case.concealed[effect].items():
            assert weighed["parameters"][effect][name] == pytest.approx(value, rel=0.1)
    page = (folder / "proof.md").read_text()
    assert "first name right, decidable single effects | at least 90 % | 100.0 % (20.7" in page


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_what_is_done_is_not_done_again(proof):
    folder, _, size = proof
    before = {p: p.stat().st_mtime_ns for p in folder.rglob("*.csv")}
    before |= {p: p.stat().st_mtime_ns for p in folder.rglob("outcome.json")}
    assert len(before) == 6  # two recordings and an outcome of each case
    done = prove(folder, size)
    assert done.returncode == 0, done.stderr
    assert {p: p.stat().st_mtime_ns for p in before} == before


TOOL = """
import json, pathlib, sys
saw = sorted(str(path) for path in pathlib.Path(".").rglob("*") if path.is_file())
output = pathlib.Path(sys.argv[2].removeprefix("output="))
(output / "saw.json").write_text(json.dumps([sys.argv[1], saw]))
if "baseline" in pathlib.Path("question.yaml").read_text():
    sys.exit("no root found")
(output / "diagnosis.json").write_text(json.dumps({"verdict": "no_mismatch", "effects": []}))
"""


def test_the_diagnosis_runs_in_the_folder_of_its_inputs_and_a_crash_is_an_outcome(tmp_path):
    store = CaseStore(tmp_path / "out", tmp_path / "sealed")
    cases = [Case(n, "reference", "reference", bool(n), seconds=1.2) for n in range(2)]
    seal(store, cases, [])
    publish(store, cases)
    script = tmp_path / "tool.py"
    script.write_text(TOOL)
    jobs = [diagnosis_job(store, case.id, script, 60.0) for case in cases]
    beside = diagnosis_job(store, cases[0].id, script, 60.0, alone=False)
    assert beside.command == (*jobs[0].command, "workers=1")
    assert len([state for state in run_jobs(jobs, 1, poll=0.02) if state.outcome]) == 2
    question, saw = json.loads((store.diagnosis(cases[0].id) / "saw.json").read_text())
    assert question == "question.yaml"
    assert saw == [
        "question.yaml",
        "recordings/drive_0.csv",
        "recordings/drive_1.csv",
        "simulator.yaml",
    ]
    assert [e.answers["ours"].status for e in asked(store, cases)] == ["answered", "crashed"]
    assert list(run_jobs(jobs, 1, poll=0.02)) == []
