"""The choice of OpenGL: in processes of its own, and what is said where there is none."""

import os
import subprocess
import sys

import pytest

from buggy_rl.visual.film import renderer as rendering


@pytest.fixture
def fresh():
    rendering.probe.cache_clear()
    yield
    rendering.probe.cache_clear()


def test_a_backend_that_is_set_is_the_only_one_tried():
    assert rendering.gl_backends({"MUJOCO_GL": "osmesa"}, "linux") == ["osmesa"]
    assert rendering.gl_backends({}, "linux") == ["egl", "osmesa"]
    assert rendering.gl_backends({"DISPLAY": ":0"}, "linux") == ["egl", "osmesa", "glfw"]
    assert rendering.gl_backends({}, "darwin") == [""]


@pytest.mark.usefixtures("fresh")
def test_a_backend_that_fails_does_so_elsewhere_and_is_named(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    found = rendering.probe()
    assert found.backend is None
    assert "MUJOCO_GL=nonsense: RuntimeError: invalid value" in found.reason


@pytest.mark.usefixtures("fresh")
def test_the_answer_is_found_once(monkeypatch):
    started = []

    class Failing:
        def __init__(self, backend):
            started.append(backend)

        def ask(self, content):
            raise rendering.WorkerError("no")

        def close(self):
            pass

    monkeypatch.setattr(rendering, "WorkerProcess", Failing)
    monkeypatch.setattr(rendering, "gl_backends", lambda environment: ["egl", "osmesa"])
    assert rendering.probe() is rendering.probe()
    assert started == ["egl", "osmesa"]


def test_a_process_that_hangs_is_ended(monkeypatch):
    monkeypatch.setattr(rendering, "PATIENCE", 0.3)
    monkeypatch.setattr(rendering.worker, "__file__", __file__)  # which neither reads nor answers
    monkeypatch.setattr(rendering.sys, "executable", "/bin/cat")
    monkeypatch.setattr(rendering.subprocess, "Popen", _sleeping(subprocess.Popen))
    process = rendering.WorkerProcess("egl")
    with pytest.raises(rendering.WorkerError, match=r"MUJOCO_GL=egl did not answer within 0\.3 s"):
        process.ask(None)
    process.close()


def _sleeping(popen):
    return lambda command, **rest: popen(["sleep", "60"], **rest)


@pytest.mark.slow  # a process that imports all there is of films
def test_importing_films_loads_nothing_of_mujoco_and_sets_nothing():
    # TorchRL imports mujoco itself, so what is looked for is what of ours needs it.
    code = (
        "import os, sys, buggy_rl.figures, buggy_rl.visual.film.film, buggy_rl.visual.film.film, "
        "buggy_rl.visual.film.source, buggy_rl.visual.film.renderer; "
        "needing = [f'buggy_rl.visual.film.{name}' for name in ('bodywork', 'scene', 'live')]; "
        "assert not set(needing) & set(sys.modules), 'imported'; "
        "assert 'MUJOCO_GL' not in os.environ"
    )
    clean = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=clean)
    assert done.returncode == 0, done.stderr
