import pytest

from buggy_rl.simulators import make_engine

OWN = """
from buggy_rl.simulators.base import HoldEngine


def factory(batch_size, device):
    return HoldEngine(batch_size, device)
"""


def test_a_users_own_simulator_is_found_by_file_and_name(tmp_path):
    (tmp_path / "mine.py").write_text(OWN)
    assert make_engine(f"{tmp_path / 'mine.py'}:factory", 5).batch_size == (5,)


def test_a_users_own_simulator_is_found_by_module():
    assert make_engine("buggy_rl.simulators.base:HoldEngine", 2).batch_size == (2,)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mujco", "available: hold, kinematic, learned, mujoco"),
        ("missing.py:factory", r"no file missing\.py"),
        ("buggy_rl.simulators.base:Nothing", "has no 'Nothing'"),
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


def test_parameters_in_a_file_reach_a_users_own_simulator(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(
        "from buggy_rl.simulators.bicycle.single_track import SingleTrackEngine as factory\n"
    )
    file = tmp_path / "car.yaml"
    file.write_text("engine: mine.py:factory\nparameters: {mass: 2.0}\n")
    assert make_engine(file, 3).values["mass"].tolist() == [2.0, 2.0, 2.0]


def test_parameters_for_a_simulator_that_takes_none_are_refused(tmp_path):
    (tmp_path / "mine.py").write_text(
        "from torchrl.envs import PendulumEnv\n\n\n"
        "def factory(batch_size, device):\n    return PendulumEnv()\n"
    )
    with pytest.raises(ValueError, match="takes no parameters"):
        make_engine(f"{tmp_path / 'mine.py'}:factory", parameters={"mass": 1.0})


def test_the_dimensions_of_another_car_come_from_a_file(tmp_path):
    file = tmp_path / "car.yaml"
    file.write_text("engine: mujoco\noptions: {dimensions: {wheelbase: 0.26, mass: 3.0}}\n")
    assert make_engine(file).values["mass"].item() == 3.0


@pytest.mark.parametrize("options", [{"timestepp": 0.001}, {}])
def test_wrong_or_missing_options_name_the_engine(options):
    with pytest.raises(ValueError, match="engine 'learned'"):
        make_engine("learned", 2, **options)


def test_a_start_of_the_wrong_shape_is_refused():
    import torch
    from tensordict import TensorDict

    engine = make_engine("hold", 4)
    with pytest.raises(ValueError, match=r"pose of shape \[4, 2\], expected \[4, 3\]"):
        engine.reset(TensorDict({"pose": torch.zeros(4, 2)}, [4]), set_state=True)


def test_a_factory_of_other_arguments_is_refused_with_those_it_is_given(tmp_path):
    (tmp_path / "mine.py").write_text("def factory(cars):\n    return cars\n")
    with pytest.raises(ValueError, match=r"mine\.py:factory is called as factory\(batch_size, dev"):
        make_engine(f"{tmp_path / 'mine.py'}:factory")
