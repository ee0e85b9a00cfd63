"""From tracks to frames, and the code of docs/simulators.md, "Films"."""

import re
from pathlib import Path

import numpy as np
import pytest

from buggy_rl.visual.film import renderer as rendering
from buggy_rl.visual.film.canvas import Inset, captioned
from buggy_rl.visual.film.film import director, frames
from buggy_rl.visual.film.options import PictureConfig
from tests.visual.film.tracks import circle, straight

PAGE = (Path(__file__).parents[3] / "docs" / "simulators.md").read_text()
FILMS = PAGE.split("\n## Films\n")[1].split("\n## ")[0]
BLOCKS = re.findall(r"^```python\n(.*?)^```", FILMS, re.M | re.S)


def test_each_frame_has_the_inset_of_its_own_time():
    says = director([circle(), straight(name="ghost")])
    plain, full = (
        list(frames(says, [0.0, 1.0, 2.0], PictureConfig(renderer="drawing", inset=inset)))
        for inset in (False, True)
    )
    for time, without, with_ in zip([0.0, 1.0, 2.0], plain, full, strict=True):
        np.testing.assert_array_equal(Inset().on(without, says.shot(time)), with_)
    assert (Inset().on(plain[0], says.shot(2.0)) != full[0]).any()


def test_captions_follow_one_another_in_equal_parts_of_the_film():
    says = director([straight()])  # 4 s
    times = [0.0, 1.9, 2.1, 4.0]
    plain, full = (
        list(frames(says, times, PictureConfig(renderer="drawing", captions=captions)))
        for captions in ([], ["first", "then"])
    )
    for without, with_, text in zip(plain, full, ["first", "first", "then", "then"], strict=True):
        np.testing.assert_array_equal(captioned(without, text), with_)


def test_the_user_is_told_once_why_it_is_drawn(monkeypatch):
    monkeypatch.setattr(
        rendering, "probe", lambda: rendering.Probe(None, "MUJOCO_GL=egl: no library")
    )
    told = []
    made = list(frames(director([straight()]), [0.0, 1.0], on_note=told.append))
    assert len(made) == 2
    assert len(told) == 1
    assert "no library" in told[0]


@pytest.mark.parametrize("block", BLOCKS)
def test_the_page_s_code_runs(block, monkeypatch, tmp_path):
    monkeypatch.setattr(rendering, "probe", lambda: rendering.Probe(None, "quicker so"))
    monkeypatch.chdir(tmp_path)
    exec(block, {})
    assert "write_video" not in block or (tmp_path / "runs" / "mine.mp4").stat().st_size > 1000
