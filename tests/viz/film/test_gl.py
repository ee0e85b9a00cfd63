import pytest

from buggy_rl.viz.film import gl
from buggy_rl.viz.film.cameras import View
from buggy_rl.viz.film.film import studio
from buggy_rl.viz.film.rendered import Rendered
from tests.viz.film.test_drawn import SIZE, VIEW, row, shot


@pytest.fixture
def no_gl(monkeypatch):
    """A machine on which nothing renders."""
    monkeypatch.setattr(gl, "_draws", lambda name: False)
    gl.backend.cache_clear()
    yield
    gl.backend.cache_clear()


def test_without_opengl_films_are_drawn_from_above_and_the_packages_are_named(no_gl):
    said = []
    with studio("auto", SIZE, 1, said.append) as drawing:
        assert drawing.frame(shot(row(0, 0)), VIEW).shape == (240, 320, 3)
    assert "apt-get install libegl1 libgl1" in said[0]


def test_a_renderer_that_was_asked_for_and_does_not_work_is_an_error(no_gl):
    with pytest.raises(ValueError, match="renderer=rendered: no OpenGL works here"):
        studio("rendered", SIZE, 1)


def test_a_chosen_backend_that_does_not_work_is_named(no_gl, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert gl.advice().startswith("MUJOCO_GL=osmesa does not work")


def test_the_first_backend_that_draws_is_taken(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(gl, "_draws", lambda name: name == "osmesa")
    gl.backend.cache_clear()
    assert gl.backend() == "osmesa"
    gl.backend.cache_clear()


def test_mujoco_renders_the_car_where_opengl_works():
    if not gl.backend():
        pytest.skip(f"no OpenGL: install Debian's {gl.PACKAGES}")
    view = View((0.0, 0.0, 0.03), 0.8, 30.0, -20.0)
    with Rendered([1.0], SIZE) as renderer:
        there = renderer.frame(shot(row(0, 0)), view)
        away = renderer.frame(shot(row(50, 0)), view)
    assert there.shape == (240, 320, 3)
    assert (there != away).any(-1).mean() > 0.02
