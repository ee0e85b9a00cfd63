"""A user's own simulator, a plain `EnvBase`, through the scripts that compare it with drives."""

import json
import runpy
import sys
from functools import cache

import pandas as pd
import pytest
import yaml

from buggy_rl.diagnosis import pipeline
from buggy_rl.diagnosis.search.joint import joint_search
from buggy_rl.recordings import save_recording
from buggy_rl.simulators import make_engine
from tests.diagnosis.planted import planted_drives

pytestmark = pytest.mark.slow  # of other simulators in tests/test_extending.py and tests/api
KEPT = (
    "diagnosis.json",
    "repaired.yaml",
    "report.html",
    "config.yaml",
    "run.json",
    "stages/mine.pt",
)
SIMULATOR = "tests/plain_env.py:make_quick"


@pytest.fixture
def run_script(monkeypatch, repository):
    """Runs a script in this process, from the root of the project."""

    def run(name, *arguments):
        monkeypatch.chdir(repository)
        monkeypatch.setattr(sys, "argv", [f"scripts/{name}.py", *arguments])
        runpy.run_path(f"scripts/{name}.py", run_name="__main__")

    return run


@pytest.fixture(scope="module")
def folder(tmp_path_factory, repository):
    """Recordings of that simulator with late steering."""
    folder = tmp_path_factory.mktemp("late")
    make = cache(lambda count: make_engine(str(repository / SIMULATOR), count))
    case = {"steering_dead_time": {"dead_time": 0.06}}
    for recording in planted_drives([case], 3, 10.0, make=make)[0]:
        save_recording(recording, folder / f"{recording.name}.csv")
    return folder


@pytest.mark.slow  # of another simulator in tests/test_examples.py, of the script in tests/api
def test_what_it_lacks_is_named(run_script, folder, tmp_path):
    run_script(
        "diagnose",
        f"simulator={SIMULATOR}",
        f"recordings=[{folder}]",
        f"output={tmp_path}",
        "effects=[steering_dead_time,steering_gain]",
        "stretches=8",
        "workers=1",
    )
    said = json.loads((tmp_path / "diagnosis.json").read_text())
    [effect] = said["effects"]
    assert effect["name"] == "steering_dead_time"
    assert effect["parameters"]["dead_time"]["value"] == pytest.approx(0.06, abs=0.01)
    assert said["fit"]["after"] < 0.5 * said["fit"]["before"]
    for file in ("report.html", "repaired.yaml"):
        assert (tmp_path / file).stat().st_size > 0


def test_it_stands_in_the_table_of_simulators_with_and_without_its_repair(
    run_script, folder, tmp_path, repository
):
    repaired = tmp_path / "repaired.yaml"
    effects = {"steering_dead_time": {"dead_time": 0.06}}
    content = {"engine": str(repository / SIMULATOR), "effects": effects}
    repaired.write_text(yaml.safe_dump(content))
    run_script(
        "evaluate_models",
        f"output={tmp_path}",
        f"data.recordings=[{folder}]",
        f"simulators.plain={SIMULATOR}",
        f"simulators.repaired={repaired}",
        "windows=4",
    )
    table = pd.read_csv(tmp_path / "table.csv").set_index("simulator")["position_mse_1s"]
    assert table["repaired"] < 0.1 * table["plain"]


OWN = """
from helper import DELAY
from tests.plain_env import make_quick as make
"""


FIRST, EDITED, AGAIN = (
    ("DELAY = 1\n", (), "", 1),
    ("DELAY = 2\n", (), "helper.py has other content now", 2),
    ("DELAY = 1\n", (), "", 2),  # what was kept first
)
ALL = (
    FIRST,
    ("DELAY = 1\n", ("workers=2", "threads=1"), "", 1),  # it goes on
    EDITED,
    ("DELAY = 2\n", ("seconds=0.9",), "seconds was 1.0, now 0.9", 3),
    ("DELAY = 1\n", (), "", 3),
)


@pytest.mark.parametrize(
    ("starts", "ended"),
    [((FIRST, EDITED, AGAIN), False), pytest.param(ALL, True, marks=pytest.mark.slow)],
    ids=["edited", "to the end"],
)
def test_an_interrupted_diagnosis_whose_simulator_was_edited_begins_anew(
    run_script, folder, tmp_path, monkeypatch, capsys, starts, ended
):
    own, output = tmp_path / "own", tmp_path / "out"
    own.mkdir()
    (own / "mine.py").write_text(OWN)
    (own / "helper.py").write_text("DELAY = 1\n")
    monkeypatch.syspath_prepend(str(own))
    (output / "stages").mkdir(parents=True)
    kept = {name: f"of another question: {name}" for name in KEPT}
    for name, text in kept.items():
        (output / name).write_text(text)
    searched = []

    def search(*arguments, **options):
        # Once in earnest: what a later one finds is kept, and of no other use here.
        searched.append(searched[0] if searched else joint_search(*arguments, **options))
        return searched[-1]

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    def run(*more):
        capsys.readouterr()
        run_script("diagnose", f"simulator={own}/mine.py:make", f"recordings=[{folder}]",
                   f"output={output}", "effects=[steering_dead_time]", "stretches=8", "minutes=0",
                   "workers=1", *more)  # fmt: skip

    monkeypatch.setattr(pipeline, "joint_search", search)
    monkeypatch.setattr("buggy_rl.diagnosis.report.page.report", lambda *_, **__: "a page")
    with monkeypatch.context() as patched:
        patched.setattr(pipeline, "answered", interrupted)
        for content, more, said, searches in starts:
            (own / "helper.py").write_text(content)
            with pytest.raises(KeyboardInterrupt):
                run(*more)
            out = capsys.readouterr()
            assert ("begun anew" in out.out + out.err) == bool(said)
            assert said in out.out + out.err
            assert len(searched) == searches
            assert {name: (output / name).read_text() for name in kept} == kept
    if not ended:
        return
    run()
    assert len(searched) == 3
    config = yaml.safe_load((output / "config.yaml").read_text())
    assert config["simulator"] == f"{own}/mine.py:make"
    assert json.loads((output / "diagnosis.json").read_text())["effects"]
    assert [file.name for file in (output / "stages").iterdir()] == ["mine.pt"]
    assert (output / "stages" / "mine.pt").read_text() == kept["stages/mine.pt"]
