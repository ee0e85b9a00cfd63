import pytest

from buggy_rl.engines import make_engine

OWN = """
from buggy_rl.engines.hold import HoldEngine


def factory(batch_size, device):
    return HoldEngine(batch_size, device)
"""


def test_a_users_own_simulator_is_found_by_file_and_name(tmp_path):
    (tmp_path / "mine.py").write_text(OWN)
    assert make_engine(f"{tmp_path / 'mine.py'}:factory", 5).batch_size == (5,)


def test_a_users_own_simulator_is_found_by_module():
    assert make_engine("buggy_rl.engines.hold:HoldEngine", 2).batch_size == (2,)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mujco", "available: hold, kinematic, learned, mujoco"),
        ("missing.py:factory", r"no file missing\.py"),
        ("buggy_rl.engines.hold:Nothing", "has no 'Nothing'"),
    ],
)
def test_an_unknown_simulator_is_refused_with_what_there_is(name: str, message: str):
    with pytest.raises(ValueError, match=message):
        make_engine(name)


def test_a_simulator_file_sets_parameters_and_ignores_what_a_fit_says_of_itself(tmp_path):
    file = tmp_path / "car.yaml"
    file.write_text("engine: single_track\nparameters: {mass: 2.0}\n_fit: {mass: {low: 1.9}}\n")
    assert make_engine(file).values["mass"].item() == 2.0


def test_a_misspelt_key_in_a_simulator_file_is_refused(tmp_path):
    file = tmp_path / "car.yaml"
    file.write_text("engine: hold\nparameter: {}\n")
    with pytest.raises(ValueError, match=r"unknown keys \['parameter'\]"):
        make_engine(file)


def test_a_parameter_the_engine_does_not_have_is_refused(tmp_path):
    file = tmp_path / "car.yaml"
    file.write_text("engine: single_track\nparameters: {weight: 2.0}\n")
    with pytest.raises(KeyError, match="no parameter weight; available:"):
        make_engine(file)
