"""A network helps, or not; it names nothing."""

import pytest

from buggy_rl.proof.baselines.retune import black_box
from tests.proof.baselines.folder import shown


def test_where_it_helps_on_what_it_has_not_seen_physics_is_missing(drives, tmp_path):
    said = black_box(shown(tmp_path, drives["draggy"]))
    assert (said["verdict"], said["effects"]) == ("unknown_physics", [])


@pytest.mark.slow
def test_where_nothing_is_missing_it_does_not_help(drives, tmp_path):
    assert black_box(shown(tmp_path, drives["nothing"]))["verdict"] == "no_mismatch"
