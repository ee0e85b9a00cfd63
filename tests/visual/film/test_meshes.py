"""Meshes, by what a solid must fulfil."""

import numpy as np
import pytest

from buggy_rl.visual.film.bodywork import hull, revolved


def volume(vertices, faces):
    """By the divergence theorem; positive if all faces look outwards."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def test_a_body_of_revolution_is_closed_and_looks_outwards():
    vertices, faces = revolved([(-1.0, 0.5), (1.0, 0.5)], 200)
    assert volume(vertices, faces) == pytest.approx(np.pi * 0.25 * 2, rel=1e-3)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1)
    _, times = np.unique(edges, axis=0, return_counts=True)
    assert (times == 2).all()


def test_a_face_that_is_turned_over_would_be_noticed():
    vertices, faces = revolved([(-1.0, 0.5), (1.0, 0.5)], 20)
    assert volume(vertices, faces[:, ::-1]) < 0


def test_lugs_stand_out_of_the_largest_radius_alone():
    vertices, _ = revolved([(-1.0, 0.4), (0.0, 0.5), (1.0, 0.4)], 12, lugs=0.1)
    radius = np.hypot(vertices[:, 0], vertices[:, 2])
    assert set(np.round(radius, 9)) == {0.0, 0.4, 0.5, 0.55}
    smooth, _ = revolved([(-1.0, 0.4), (0.0, 0.5), (1.0, 0.4)], 12)
    assert np.hypot(smooth[:, 0], smooth[:, 2]).max() == pytest.approx(0.5)


def test_a_hull_is_symmetric_about_the_plane_of_travel():
    corners = hull([(0.0, 0.3, 0.2, 0.0, 1.0), (1.0, 0.1, 0.1, 0.1, 0.5)])
    mirrored = corners * [1, -1, 1]
    assert {tuple(p) for p in corners} == {tuple(p) for p in mirrored}
    assert len(corners) == 8
