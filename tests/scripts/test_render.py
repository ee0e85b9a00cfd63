"""The script as a user runs it, drawn from above: OpenGL is not there everywhere."""

import subprocess
import sys

import imageio.v2 as imageio
import pytest

SMALL = ("renderer=drawn", "size=[160,120]", "fps=5", "seconds=0.6")


@pytest.fixture
def render(repository):
    def run(*arguments: str) -> subprocess.CompletedProcess:
        command = [sys.executable, "scripts/render.py", *arguments]
        return subprocess.run(command, cwd=repository, capture_output=True, text=True)

    return run


def test_a_recording_and_a_simulator_beside_it_become_a_film(render, tmp_path):
    file = tmp_path / "film.mp4"
    done = render("what=data/sample/sample_00.csv", "ghost=kinematic", f"output={file}", *SMALL)
    assert done.returncode == 0, done.stderr
    assert f"written: {file}" in done.stdout
    with imageio.get_reader(file) as reader:
        assert reader.count_frames() == 4  # type: ignore[attr-defined]
        assert reader.get_data(0).shape == (120, 160, 3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["what=kinematic", "output=film.avi"], "output=film.avi: must end in .mp4, .gif, .png"),
        (["what=kinematic", "size=[100]"], "size=[100]: must be an even width and height"),
        (["what=nothing.csv"], "nothing.csv"),
        ([], "what"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(render, tmp_path, arguments, message):
    done = render(*arguments)
    assert done.returncode != 0
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_help_needs_no_torch(repository):
    command = [sys.executable, "-X", "importtime", "scripts/render.py", "--help"]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True)
    assert done.returncode == 0
    assert "camera='chase'" in done.stdout
    assert "torch" not in done.stderr
