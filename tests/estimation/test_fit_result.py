"""A fit that cannot be trusted says so; ranges can be widened where the car needs it."""

from dataclasses import replace

import pytest

from buggy_rl.core.config import build
from buggy_rl.estimation.fit_result import as_simulator
from buggy_rl.estimation.fit_study import StudyConfig, fit_setup
from buggy_rl.estimation.least_squares import FitConfig, least_squares_fit
from buggy_rl.recordings.recording import Recording
from buggy_rl.simulators import make_engine
from tests.estimation.test_least_squares import drives, make

QUICK = FitConfig(parameters=["push", "drag", "turn"], windows=12)


@pytest.fixture(scope="module")
def recordings():
    return drives(0.02, 2)


@pytest.fixture(scope="module")
def sound(recordings):
    return least_squares_fit(make, recordings, replace(QUICK, iterations=30))


def test_a_sound_fit_has_no_warning_and_writes_none(sound):
    assert sound.warnings == []
    assert "_warnings" not in as_simulator("toy", sound, {})
    assert sound.error < 0.3 * sound.hold_error


def test_a_fit_that_stops_early_is_said_not_to_have_converged(recordings):
    found = least_squares_fit(make, recordings, replace(QUICK, iterations=1))
    assert "the fit did not converge: raise fit.iterations" in found.warnings
    assert as_simulator("toy", found, {})["_warnings"] == found.warnings


def test_a_fit_at_the_edge_of_its_ranges_names_the_parameters_and_the_remedies(recordings):
    def narrow(count):
        engine = make(count)
        engine.declared["push"] = replace(engine.declared["push"], upper=3.0)
        return engine

    (warning,) = least_squares_fit(narrow, recordings, replace(QUICK, iterations=30)).warnings
    assert "at the edge of their ranges: push" in warning  # the truth is 4
    assert "fit_options.ranges.NAME=[low,high]" in warning


def test_a_fit_no_better_than_holding_the_velocity_is_said_to_be_so(recordings):
    """A car that keeps its speed without drive: no drag of at least 0.1 /s explains it."""
    glides = [Recording(r.name, r.data.clone(), r.dt) for r in recordings]
    for recording in glides:
        data = recording.data
        data["action"][:] = -1.0
        data["velocity"] = 0.01 * data["velocity"] + data["velocity"].new_tensor([1.0, 0.0, 0.0])
        data["pose"] = data["t"].float() * data["pose"].new_tensor([1.0, 0.0, 0.0])
    found = least_squares_fit(make, glides, QUICK)
    assert "no better than holding the last velocity" in found.warnings[0]
    assert "check units, signs" in found.warnings[0]


def test_ranges_of_a_simulator_file_reach_the_engine_and_its_copies(tmp_path):
    file = tmp_path / "car.yaml"
    file.write_text("engine: single_track\nparameters: {mass: 30.0}\nranges: {mass: [1.0, 40.0]}\n")
    engine = make_engine(file, 2)
    assert engine.values["mass"].item() == 30.0
    assert (engine.declared["mass"].lower, engine.declared["mass"].upper) == (1.0, 40.0)
    from tensordict import TensorDict

    assert engine.with_parameters(TensorDict({}, [3])).declared["mass"].upper == 40.0


def test_ranges_reach_a_users_own_simulator(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(
        "from buggy_rl.simulators.bicycle.single_track import SingleTrackEngine as factory\n"
    )
    file = tmp_path / "car.yaml"
    file.write_text("engine: mine.py:factory\nranges: {mass: [1.0, 40.0]}\n")
    assert make_engine(file, 2).declared["mass"].upper == 40.0
    file.write_text("engine: mine.py:factory\nranges: {weight: [1.0, 40.0]}\n")
    with pytest.raises(ValueError, match="ranges: no parameter weight; available: cg_to_front"):
        make_engine(file, 2)


@pytest.mark.parametrize(
    ("ranges", "words"),
    [
        ({"mass": [40.0, 1.0]}, r"ranges: mass is \[40.0, 1.0\]: write \[lower, upper\], in kg"),
        ({"mass": [1.0]}, "ranges: mass"),
        ({"mass": [2.0, 3.0]}, "parameter 'mass' is 1.625 kg, outside its range"),
    ],
)
def test_a_range_that_cannot_be_is_refused(ranges, words):
    with pytest.raises(ValueError, match=words):
        make_engine("single_track", ranges=ranges)


def test_dimensions_are_an_option_of_the_fitted_single_track():
    options = ["output=o", "data.recordings=[x]", "fit_simulator=single_track"]
    study = build(StudyConfig, [*options, "fit_options.dimensions={wheelbase: 0.5, mass: 5.8}"])
    setup = fit_setup(study)
    engine = make_engine("single_track", **setup["options"], parameters={"yaw_inertia": 0.35})
    assert engine.vehicle().wheelbase == pytest.approx(0.5)
    assert engine.values["mass"].item() == pytest.approx(5.8)
