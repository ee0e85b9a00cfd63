"""`scripts/render.py` as a user runs it."""

import numpy as np
from imageio_ffmpeg import count_frames_and_secs
from PIL import Image

from tests.running import Done, run_script

SMALL = ("size=[128,96]", "renderer=drawing", "seconds=0.4")


def render(*arguments: str) -> Done:
    return run_script("scripts/render.py", *arguments)


def test_a_recording_beside_a_simulator_becomes_a_film(tmp_path):
    file = tmp_path / "film.mp4"
    done = render(
        "what=data/sample/sample_00.csv", "ghost=kinematic", "start=3", f"output={file}", *SMALL
    )
    assert done.returncode == 0, done.stderr
    assert "11 frames, 0.4 s driven" in done.stdout
    assert count_frames_and_secs(str(file))[0] == 11


def test_a_picture_and_one_line_about_what_is_wrong(tmp_path):
    file = tmp_path / "picture.png"
    done = render("what=kinematic", "course=lap", f"output={file}", "camera=fixed", *SMALL)
    assert done.returncode == 0, done.stderr
    assert np.asarray(Image.open(file)).shape == (96, 128, 3)
    wrong = render("what=nowhere.csv", f"output={file}")
    assert wrong.returncode == 1
    assert "error: there is no file nowhere.csv: correct the path" in wrong.stderr
    assert "Traceback" not in wrong.stderr
