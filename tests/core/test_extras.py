"""A package that is not installed: one line that names the extra, and nothing written."""

import re
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from buggy_rl.core.extras import MissingExtraError, needs
from buggy_rl.core.run_log import RunLog
from buggy_rl.jobs.launching import required
from buggy_rl.recordings import load_recordings, save_recording
from buggy_rl.visual.film.video import write_video
from tests.diagnosis.planted import planted_drives

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
MOST = 16  # packages of the base installation


def names(requirements: list[str]) -> set[str]:
    return {re.split(r"[\[<>=]", requirement)[0] for requirement in requirements}


def test_the_base_installation_is_small_and_the_developers_has_all_extras_but_large_peers():
    extras = PROJECT["optional-dependencies"]
    assert len(PROJECT["dependencies"]) <= MOST
    assert {"bags", "car", "proof", "scale", "visual"} <= set(extras)
    (every,) = (r for r in extras["dev"] if r.startswith("buggy_rl["))
    assert set(every[len("buggy_rl[") : -1].split(",")) == set(extras) - {"dev", "gpu", "peers"}
    assert "buggy_rl[gpu]" in extras["peers"]


@pytest.mark.parametrize(
    ("package", "extra", "requirement"),
    [
        ("rosbags", "bags", "rosbags"),
        ("pyarrow", "bags", "pyarrow"),
        ("viser", "visual", "viser"),
        ("websockets", "visual", "websockets"),
        ("imageio_ffmpeg", "visual", "imageio-ffmpeg"),
        ("tensorboard", "visual", "tensorboard"),
        ("sklearn", "proof", "scikit-learn"),
        ("ray", "scale", "ray"),
    ],
)
def test_an_extra_installs_what_it_is_named_for(package, extra, requirement, monkeypatch):
    assert requirement in names(PROJECT["optional-dependencies"][extra])
    assert requirement not in names(PROJECT["dependencies"])
    monkeypatch.setitem(sys.modules, package, None)  # as if it were not installed
    what = "this test"
    line = rf"^this test needs the package {package}: pip install 'buggy_rl\[{extra}\]'$"
    with pytest.raises(MissingExtraError, match=line):
        needs(package, extra, what)


def test_a_package_that_is_there_is_given_back():
    assert needs("numpy", "bags", "this test") is np


def test_a_package_that_is_there_but_broken_says_why(tmp_path, monkeypatch):
    (tmp_path / "half_installed.py").write_text("from math import no_such_name\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MissingExtraError, match="it is there: cannot import name 'no_such_name'"):
        needs("half_installed", "bags", "this test")


def test_a_bag_and_a_parquet_file_say_which_extra_reads_them(tmp_path, monkeypatch):
    (tmp_path / "drive.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "drive.parquet").write_bytes(b"PAR1")
    for package in ("rosbags", "pyarrow"):
        monkeypatch.setitem(sys.modules, package, None)
    for file in ("drive.bag", "drive.parquet"):
        with pytest.raises(MissingExtraError, match=rf"{file} needs .*'buggy_rl\[bags\]'"):
            load_recordings(tmp_path / file)


def test_what_cannot_be_written_leaves_no_file(tmp_path, monkeypatch):
    for package in ("pyarrow", "imageio_ffmpeg"):
        monkeypatch.setitem(sys.modules, package, None)
    recording = planted_drives([{}], seconds=1.0)[0][0]
    with pytest.raises(MissingExtraError, match=r"'buggy_rl\[bags\]'"):
        save_recording(recording, tmp_path / "drive.parquet")
    with pytest.raises(MissingExtraError, match=r"'buggy_rl\[visual\]'"):
        write_video(iter([np.zeros((4, 4, 3), np.uint8)]), str(tmp_path / "drive.mp4"), 25.0)
    assert not list(tmp_path.iterdir())


def test_a_launcher_says_which_extra_it_needs(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ValueError, match=r"launcher=ray needs .*'buggy_rl\[scale\]'"):
        required("ray", "launcher=ray")


def test_without_tensorboard_a_log_is_csv_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    log = RunLog(tmp_path, "steps", {})
    log.add({"steps": 3, "reward": 0.5})
    with pytest.warns(UserWarning, match=r"'buggy_rl\[visual\]'; the log is CSV alone"):
        log.write()
    log.close()
    assert (tmp_path / "csv" / "scalars" / "reward.csv").read_text().startswith("3,0.5")
    assert not (tmp_path / "tensorboard").exists()
