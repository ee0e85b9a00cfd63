"""The report: self-contained, equal to the answer, and complete for every verdict."""

import math
import re
from dataclasses import replace
from datetime import date
from html.parser import HTMLParser

import pytest
import torch
import yaml
from torchrl.envs import TransformedEnv

from buggy_rl.diagnosis.answer.answer import Answer, Proof
from buggy_rl.diagnosis.answer.behaviour import Behaviour, FormFault
from buggy_rl.diagnosis.answer.equivalents import Equivalents
from buggy_rl.diagnosis.answer.experiments import DecisionRate
from buggy_rl.diagnosis.answer.located import Region, locate
from buggy_rl.diagnosis.answer.manoeuvres import MANOEUVRES
from buggy_rl.diagnosis.answer.named_effect import NamedEffect, Value
from buggy_rl.diagnosis.answer.other_sensors import LATE, SensorFinding
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.repair.layers import Layer
from buggy_rl.diagnosis.repair.proof import Repair
from buggy_rl.diagnosis.report import page as pages
from buggy_rl.diagnosis.report import report, sheet_of, wording
from buggy_rl.diagnosis.report.figures import errors, manoeuvre_plan, replays, worst_segment
from buggy_rl.diagnosis.report.wording import alternatives, ranking
from buggy_rl.diagnosis.residuals import unexplained
from buggy_rl.diagnosis.run.case import Drives, prepare_case
from buggy_rl.diagnosis.search.posterior import Posterior
from buggy_rl.diagnosis.search.result import SearchResult, State, tried_too
from buggy_rl.effects import effect_class, make_effect
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.policies.controllers.recording import recorded_steps
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.recordings import Recording
from buggy_rl.recordings.camera import Camera, CameraConfig
from buggy_rl.simulators import make_engine

GAIN = 0.7
NAME = 'drive <b>"1"</b> & $x_1'
VOID = {"meta", "br", "use", "img"}


def weaker_steering(cars):
    """A single-track car whose steering turns the wheels by less than the simulator thinks."""
    gain = make_effect("steering_gain", {"gain": GAIN})
    return TransformedEnv(make_engine("single_track", cars), gain)


@torch.no_grad()
def drives(seconds=5.0):
    """Three at once: each is a block of its own when blocks are held out."""
    rows = list(recorded_steps(weaker_steering(3), RoomDriver(seed=3), round(seconds / 0.01)))
    true = torch.stack(rows, 1)  # (3, T)
    names = (NAME, "second", "third")
    return [
        Recording(name, Camera(CameraConfig(), car).recorded(true[car]), 0.01)
        for car, name in enumerate(names)
    ]


def found_in(case):
    """What a search of two effects came to."""
    names = ((), ("steering_gain",), ("steering_offset",))
    starts = [case.problem.library.hypothesis(effects) for effects in names]
    state, [_, best, _] = tried_too(State(case.problem, {}), starts, case.criteria)
    posterior = Posterior({(): 0.0, ("steering_gain",): 0.93, ("steering_offset",): 0.02}, 0.05)
    return SearchResult(best, state.tried, case.problem.noise, 1.0, posterior)


def said_of(case, found):
    """The answer, with round numbers where it would take long to compute them."""
    problem, best = case.problem, found.best.fit
    rest = unexplained(problem, found.null.fit.whitened, best.whitened, 0.05)
    gain = best.values()["steering_gain"]["gain"]
    kind = effect_class("steering_gain")
    named = NamedEffect(
        name="steering_gain",
        kind=kind.kind,
        equation=kind.equation,
        sentence=kind.sentence({"gain": gain}),
        parameters={"gain": Value(gain, gain - 0.0111, gain + 0.0222, "ratio")},
        confidence=0.93,
        held_out_gain=0.87,
    )
    proof = Proof(
        before={0.3: 4e-6, 1.0: 0.0625**2},
        after={0.3: 1e-6, 1.0: 0.004**2},
        retuned={},
        noise_floor={0.3: 1e-6, 1.0: 1e-6},
        black_box={},
        misfit_before=8.125,
        misfit_after=1.0625,
        held_out=True,
    )
    where = locate(case.given, problem.segments, problem.noise.sd, case.names)
    fit = best.as_stamped
    return Answer(
        *("missing_physics", where, [named], rest, proof, ["no <jumps>"], ["slalom & stop"]),
        repair=Repair(fit.values(), fit=fit),
    )


@pytest.fixture(scope="module")
def diagnosis():
    """A case, what its search found, and the answer."""
    library = Library(["steering_gain", "steering_offset"])
    config = DiagnosisConfig(simulator="single_track", recordings=[], output="")
    simulation = Simulation(lambda cars: make_engine("single_track", cars))
    case = prepare_case(simulation, Drives.cut(config, drives()), library, config)
    found = found_in(case)
    return case, found, said_of(case, found)


@pytest.fixture(scope="module")
def page(diagnosis):
    return report(*diagnosis)


def with_simulator(case, make):
    simulation = replace(case.problem.simulation, make=make)
    return replace(case, problem=replace(case.problem, simulation=simulation))


def text_of(case, found, said, part=""):
    """Text of a section of the page, by its heading, or of all; without the figures."""
    page = pages.rendered(case, found, said)
    if part:
        [page] = [s for s in page.split("<section>") if f">{part}</h" in s]
        page = page.partition("</section>")[0]
    return Page(page).text


class Page(HTMLParser):
    """Elements that refer to something, the text, and whether all that opens is closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.references, self.tags, self.words = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        self.references += [v for n, v in attrs if n in ("src", "href", "xlink:href", "data")]

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.words.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.words))


def test_the_page_needs_nothing_from_outside(page):
    assert "http" not in page
    assert "url(" not in re.sub(r"url\(#\w+\)", "", page)
    assert "@import" not in page
    read = Page(page)
    assert not {"script", "link", "iframe", "object", "embed"} & set(read.tags)
    inside = ("#", "data:image/png;base64,", "data:image/gif;base64,")
    assert all(r.startswith(inside) for r in read.references)


def test_the_page_is_well_formed_and_fits_a_phone(page):
    assert Page(page).open == []
    assert page.startswith("<!doctype html>")
    assert 'name="viewport"' in page
    assert "@media print" in page
    assert len(page) < 2_000_000


def test_the_lines_and_the_numbers_are_on_it(diagnosis, page):
    *_, said = diagnosis
    text = Page(page).text
    assert said.lines()[0] in text
    [effect] = said.effects
    assert f"{effect.sentence[:1].upper()}{effect.sentence[1:]}." in text
    assert effect_class(effect.name).look_at in text
    value = effect.parameters["gain"]
    assert value.value == pytest.approx(GAIN, abs=0.02)
    assert f"{value.value:.3g}" in text
    assert f"{value.low:.3g} to {value.high:.3g}" in text
    assert effect.equation in text
    assert "62 mm" in text  # 62.5, rounded to even
    assert "8.12 before, 1.06 after" in text
    assert "no <jumps>" in text
    assert "slalom & stop" in text


def test_a_name_with_markup_in_it_comes_out_as_text(page):
    assert NAME in Page(page).text
    assert "<b>" not in page


def test_figures_show_measured_simulated_and_repaired(diagnosis, page):
    left = 2 * pages.something_is_left(diagnosis[2])  # errors by position, by speed and steering
    assert page.count("<svg") == 3 + left  # three segments
    assert "repaired" in Page(page).text
    shown = replays(*diagnosis[:2], diagnosis[2].repair)
    assert len(shown) == 3
    for replay in shown[:2]:
        off, better = (
            abs(motion[:, 5] - replay.measured[:, 5]).mean()
            for motion in (replay.simulated, replay.repaired)
        )
        assert better < 0.5 * off


def test_a_replay_begins_where_the_car_was(diagnosis):
    for replay in replays(*diagnosis[:2], diagnosis[2].repair):
        # One row on: 10 ms at no more than 4 m/s is 40 mm, and 5 mm for noise.
        assert abs(replay.measured[0, :2]).max() < 0.045
        assert abs(replay.simulated[0, :2] - replay.measured[0, :2]).max() < 0.01


def test_errors_of_a_right_simulator_are_the_noise(diagnosis):
    case, _, said = diagnosis
    before = errors(case, Repair())
    after = errors(with_simulator(case, weaker_steering), Repair())
    assert (after.size**2).mean() == pytest.approx(1.0, abs=0.25)
    assert (before.size**2).mean() > 3.0
    assert (errors(case, said.repair).size ** 2).mean() == pytest.approx(1.0, abs=0.25)  # repaired
    assert len(said.located.channel_share) == 3


def test_the_selected_hypothesis_leads_the_ranking_and_every_alternative_is_worse(diagnosis):
    _, found, _ = diagnosis
    ranks = ranking(found, 5)
    assert ranks[0].chosen
    assert ranks[0].effects == ("steering_gain",)
    assert [r.nats for r in ranks] == sorted((r.nats for r in ranks), reverse=True)
    others = dict(alternatives(found, "steering_gain"))
    assert set(others) == {"", "steering_offset"}
    assert min(others.values()) > 0
    assert others[""] == pytest.approx(ranks[0].nats)  # no effect instead is the null


@pytest.mark.parametrize("verdict", list(wording.MEANINGS))
def test_every_verdict_says_what_it_means(diagnosis, verdict):
    case, found, said = diagnosis
    shown = replace(said, verdict=verdict)
    text = text_of(case, found, shown)
    assert wording.MEANINGS[verdict] in text
    assert wording.plain(verdict) in text
    assert shown.lines()[0] in text
    assert "93% confidence" in text


def test_of_a_re_tuned_simulator_the_report_has_the_values_as_given(diagnosis):
    case, found, said = diagnosis
    simulation = case.problem.simulation
    given = simulation.make(1).declared["mass"].value

    def tuned(cars):
        return make_engine("single_track", cars, parameters={"mass": 2 * given})

    own = {"mass": tuned(1).declared["mass"]}
    library = Library(case.problem.library.effects, own, own=False)
    problem = replace(with_simulator(case, tuned).problem, library=library)
    again = replace(case, problem=problem, retuned_from=simulation)
    assert case.as_given is case.problem.library
    assert again.as_given.numbers("parameter:mass")[0].value == given
    value = Value(2 * given, 1.9 * given, 2.1 * given, "kg")
    mass = replace(
        said.effects[0], name="parameter:mass", kind="parameter", parameters={"mass": value}
    )
    text = text_of(again, found, replace(said, effects=[mass]))
    assert f"{given:.3g} kg" in text
    assert "All re-tuned parameters together" in text
    assert "Parameters were re-tuned together, without alternatives." in text
    assert "Rejected" not in text
    assert "Instead of" not in text


@pytest.mark.parametrize("verdict", ["no_mismatch", "unknown_physics"])
def test_where_no_effect_is_named_the_report_names_none(diagnosis, verdict):
    case, found, said = diagnosis
    shown = replace(said, verdict=verdict, effects=[], repair=Repair())
    text = text_of(case, replace(found, best=found.null), shown)
    assert wording.MEANINGS[verdict] in text
    assert text.count("No effect is named.") == 2
    assert "None is selected" in text
    assert "There is no repaired simulator: nothing that was tried brings rollouts nearer." in text
    assert "confidence" not in text


def test_an_alternative_that_is_not_rejected_is_not_listed_as_rejected(diagnosis):
    case, found, said = diagnosis
    effect = replace(said.effects[0], confused_with={"steering_offset": 0.31})
    text = text_of(case, found, replace(said, effects=[effect]), "Evidence and method")
    assert "steering offset: probability 31%" in text
    assert "steering offset: worse by" not in text
    assert "no effect: worse by" in text
    text = text_of(case, found, said, "Evidence and method")
    assert "steering offset: worse by" in text


def test_warnings_are_only_of_effects_at_a_bound_or_misspecified(diagnosis):
    case, found, said = diagnosis
    doubtful = replace(said.effects[0], at_bound=("gain",), varies_with="abs_steering")
    text = text_of(case, found, replace(said, effects=[doubtful]))
    assert "Gain lies at a bound of its range" in text
    assert "Its parameters vary with the magnitude of the steering command" in text
    text = text_of(case, found, said)
    assert "bound" not in text
    assert "misspecified" not in text


def test_a_simulator_that_is_not_finite_is_drawn_as_far_as_it_is(diagnosis):
    case, found, said = diagnosis

    class Broken(type(make_engine("single_track", 1))):
        def _step(self, tensordict):
            result = super()._step(tensordict)
            result["velocity"][..., 0] = float("nan")
            return result

    proof = Proof({1.0: float("nan")}, {1.0: 0.01}, {}, {}, {}, float("nan"), 1.0, False)
    shown = replace(said, proof=proof, notes=["the simulator broke <off>"])
    text = Page(report(with_simulator(case, lambda cars: Broken(cars)), found, shown)).text
    assert "–" in text
    assert "too few to hold some out" in text
    assert "the simulator broke <off>" in text


def test_what_other_sensors_say_is_on_the_page(diagnosis):
    case, found, said = diagnosis
    late = SensorFinding("pose_lateness", LATE, "s", 0.03, 0.029, 0.032)
    assert late.line() in text_of(case, found, replace(said, sensors=[late]))
    assert "Sensors beside the pose" not in text_of(case, found, said)


def test_the_same_case_makes_the_same_page(diagnosis, page):
    assert report(*diagnosis) == page


def test_a_parameter_of_the_simulator_is_called_so():
    assert wording.effect("parameter:front_friction") == "the simulator's front friction"
    assert wording.effect("my/file.py:StickyServo") == "StickyServo"
    assert wording.effect("") == "no effect"


def test_small_shares_are_not_rounded_to_none():
    assert wording.percent(0.0) == "0%"
    assert wording.percent(0.001) == "under 1%"
    assert wording.percent(0.314) == "31%"
    assert wording.confidence(0.997) == "99%"
    assert wording.confidence(0.314) == "31%"


def test_bars_stay_in_their_track():
    assert [wording.width(share) for share in (3.0, -1.0, math.nan)] == ["100.0", "0.0", "0.0"]


def test_a_region_has_features_in_common_units():
    # pi/2 rad is 90 degrees; 0.25 and 0.5 of a command have no unit.
    found = Region({"heading": (0.0, math.pi / 2), "steering": (0.25, 0.5)}, 0.62, 0.1)
    assert wording.region(found) == (
        "Heading 0 to 90 ° and steering command 0.25 to 0.5: 62% of the error in 10% of the data"
    )


def test_only_a_finite_lag_is_listed():
    lags = {"steering": {"yaw_rate": 0.06, "vx": math.nan}, "throttle": {"vx": math.nan}}
    assert wording.lags(lags) == ["Errors in yaw rate follow changes of the steering by 60 ms"]


@pytest.mark.parametrize(
    ("verdict", "decided"), [("missing_physics", True), ("cannot_tell", False)]
)
def test_data_are_sufficient_only_where_the_verdict_is_decided(diagnosis, verdict, decided):
    case, found, said = diagnosis
    silent = replace(said, verdict=verdict, weak=[], suggest=[])
    text = text_of(case, found, silent, "What to drive next")
    assert ("These data are sufficient" in text) == decided
    assert ("No manoeuvre" in text) == (not decided)


def test_a_quantity_has_its_unit_and_a_limit_that_is_never_reached_is_none():
    assert wording.quantity(0.0612, "m/s^2") == "0.0612 m/s²"
    assert wording.quantity(0.0598, "s") == "59.8 ms"
    assert wording.quantity(1.5, "s") == "1.5 s"
    assert wording.neutral(1e9, "m/s") == "none"
    assert wording.neutral(1.0, "-") == "1"


def test_step_tests_and_faults_of_form_have_their_place(diagnosis):
    case, found, said = diagnosis
    assert "Step tests" not in text_of(case, found, said)
    late = Behaviour(
        "steering_response", "to half of the yaw rate", "s", 0.08, 0.14, 0.13, 0.15, True
    )
    fault = FormFault("vx", "lateral_acceleration", 1.0, 2.0, 0.1)
    said = replace(said, behaviours=[late], form=[fault])
    tests = text_of(case, found, said, "Step tests of both simulators")
    assert "to half of the yaw rate 80 ms 140 ms (130 to 150 ms) yes" in " ".join(tests.split())
    rest = text_of(case, found, said, "What the repair does not explain")
    assert "Speed 0.1 m/s too high (median) at lateral acceleration 1 to 2 m/s²." in rest


def test_an_interval_has_digits_that_tell_its_bounds_apart_or_is_not_printed():
    assert wording.between((0.054, 0.066), "s") == "54 to 66 ms"
    assert wording.between((0.12212, 0.12238), "s") == "122.1 to 122.4 ms"
    assert wording.between((-0.5, 1.5), "m/s^2") == "-0.5 to 1.5 m/s²"
    assert wording.between((6.99, 6.99), "m/s^2") == ""
    still = Behaviour("coasting", "without drive", "m/s^2", 6.99, 6.99, 6.99, 6.99, False)
    assert wording.repaired_quantity(still) == "unchanged"
    assert wording.repaired_quantity(replace(still, value=7.5, low=7.5, high=7.5)) == "7.5 m/s²"


@pytest.mark.parametrize(("gain", "words"), [(1.013, "all"), (0.87, "87%"), (-0.2, "none")])
def test_an_effect_closes_all_of_the_residual_at_most(diagnosis, gain, words):
    case, found, said = diagnosis
    shown = replace(said, effects=[replace(said.effects[0], held_out_gain=gain)])
    assert f"It closes {words} of the held-out residual" in text_of(case, found, shown)


def test_the_finding_comes_first_and_where_errors_were_last(diagnosis, page):
    *_, said = diagnosis
    text = Page(page).text
    sentence = f"{wording.capital(said.effects[0].sentence)}."
    order = [
        sentence,
        "95 % interval",
        "On the car: Measure the wheels' angle",
        "Before and after the repair",
        "at half speed",
        "What to drive next",
        "What the repair does not explain",
        "Evidence and method",
    ]
    places = [text.index(words) for words in order]
    assert places == sorted(places)
    assert "The largest share of the error" not in text  # of the simulator as given
    folded = page.index("<details>")
    assert "nats" not in page[:folded]
    assert "nats" in page[folded:]


@pytest.mark.parametrize("excess", [0.01, 2.0])
def test_errors_are_located_only_where_something_is_left(diagnosis, excess):
    case, found, said = diagnosis
    rest = replace(said.remaining, excess=excess, channel={"x": 0.01, "yaw_rate": 0.99})
    shown = replace(said, remaining=rest)
    part = text_of(case, found, shown, "What the repair does not explain")
    assert ("yaw rate 99%" in part) == (excess > 1)
    assert ("Unexplained share" in part) == (excess > 1)


def test_evidence_of_nothing_fills_no_bar(diagnosis):
    case, found, said = diagnosis
    html = pages.rendered(case, found, replace(said, effects=[]))
    widths = [float(w) for w in re.findall(r"width:([\d.]+)%", html)]
    assert max(widths) == 100.0
    few = [replace(rank, nats=rank.nats / 1e5) for rank in ranking(found, 3)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pages, "ranking", lambda *_: few)
        html = pages.rendered(case, found, replace(said, effects=[]))
    widths = [float(w) for w in re.findall(r"width:([\d.]+)%", html[html.index("<details>") :])]
    assert max(widths) < 5.0


def test_alternatives_that_cannot_be_told_apart_are_one_line_and_each_says_where_to_look(diagnosis):
    case, found, said = diagnosis
    both = Equivalents(
        ("steering_gain", "steering_offset"),
        0.9,
        (0.5, 0.4),
        1.0,
        ("the wheels turn 30 % less than the steering says", "the steering pulls to the left"),
    )
    text = text_of(case, found, replace(said, equivalents=[both]))
    assert text.count(both.line()) == 1
    for name in both.effects:
        assert effect_class(name).look_at in text


def test_the_suggested_manoeuvre_is_drawn_as_each_hypothesis_predicts_it(diagnosis):
    case, found, said = diagnosis
    between = (("steering_gain",), ("steering_offset",))
    rate = DecisionRate("slalom", "steady speed, slalom", 0.9, 0.95, between)
    shown = replace(said, manoeuvres=[rate], suggest=[rate.line()])
    plan = manoeuvre_plan(case, found, shown)
    assert plan is not None
    assert list(plan.predicted) == ["steering gain", "steering offset"]
    slalom = next(m for m in MANOEUVRES if m.name == "slalom")
    assert plan.action.tolist() == slalom.actions(0.01).tolist()
    # The weaker steering turns less: its path is not that of the other.
    one, other = plan.predicted.values()
    assert abs(one - other)[:, 5].max() > 0.3
    assert plan.telling == 5
    [(caption, drawing)] = pages.planned(case, found, shown)
    assert caption.startswith("Steady speed, slalom")
    assert "yaw rate" in drawing
    assert pages.planned(case, found, replace(said, manoeuvres=[rate], suggest=[])) == []


def test_the_film_is_of_the_worst_segment_and_ends_where_a_car_leaves_the_picture(diagnosis):
    case, _, said = diagnosis
    made = worst_segment(case, said.repair)
    assert made is not None
    given, repaired = map(int, re.findall(r"(\d+) mm", made.caption))
    assert repaired < 0.3 * given
    assert made.uri.startswith("data:image/gif;base64,")
    away = with_simulator(case, fast).problem.simulation
    left = worst_segment(replace(case, retuned_from=away), Repair())
    assert left is not None
    [(begin, end)] = re.findall(r"([\d.]+) to ([\d.]+) s", left.caption)
    assert float(end) - float(begin) < 1.9  # of 2 s


def fast(cars):
    """A car whose motor has three times the force."""
    force = make_engine("single_track", 1).declared["drive_force"].value
    return make_engine("single_track", cars, parameters={"drive_force": 3 * force})


def test_the_sheet_is_on_the_page(diagnosis):
    case, found, said = diagnosis
    config = DiagnosisConfig(
        simulator="my.py:make", recordings=["drives"], output="", car="f1tenth"
    )
    made = sheet_of(config, {"engine": "my.py:make", "effects": {"steering_gain": {"gain": 0.7}}})
    text = Page(pages.rendered(case, found, said, sheet=made)).text
    for words in ("Simulator my.py:make", "Car f1tenth", "Recordings drives", "Version buggy_rl"):
        assert words in text
    assert date.today().isoformat() in text
    assert "Command python" in text
    assert yaml.safe_load(made.repaired)["effects"] == {"steering_gain": {"gain": 0.7}}
    assert "effects: steering_gain: gain: 0.7" in text


def test_layers_go_down_to_the_noise_beside_what_is_simpler(diagnosis):
    case, found, said = diagnosis
    layers = [
        Layer("effects", ("steering_gain",), 1.2, 0.1, True, {0.3: 0.004, 1.0: 0.02}),
        Layer("terms", ("term.yaw.throttle",), 0.5, 0.1, True, {0.3: 0.002, 1.0: 0.0064}),
        Layer("residual", (), -0.1, 0.1, False, {0.3: 0.003, 1.0: 0.012}),
    ]
    median = {"before": {0.3: 0.008, 1.0: 0.06}, "retuned": {0.3: 0.005, 1.0: 0.03}}
    median["noise_floor"] = {0.3: 0.001, 1.0: 0.0036}
    shown = replace(said, layers=layers, proof=replace(said.proof, median=median))
    steps = pages.waterfall(shown)
    assert list(steps) == ["0.3 s", "1 s"]
    assert [(s.words, s.kind, words) for s, _, words in steps["1 s"]] == [
        ("as given", "compared", "60 mm"),
        ("steering gain", "kept", "20 mm"),
        ("an equation", "kept", "6.4 mm"),
        ("a learned residual", "left", "12 mm"),
        ("re-tuned alone", "compared", "30 mm"),
        ("a simulator without fault (noise of sensor and start)", "compared", "3.6 mm"),
    ]
    assert steps["1 s"][0][1] == 1.0
    text = text_of(case, found, shown)
    assert "+ a learned residual (left out) 12 mm" in text
    assert pages.waterfall(said) == {}


def test_an_equation_without_a_name_is_on_the_page_with_what_is_the_same(diagnosis):
    case, found, said = diagnosis
    kind = effect_class("term.yaw.throttle.even_square")
    term = NamedEffect(
        name="term.yaw.throttle.even_square",
        kind="term",
        equation=kind.equation,
        sentence=kind.sentence({"coefficient": 6.7}),
        parameters={"coefficient": Value(6.7, 5.1, 8.3, "rad/s^2")},
        confidence=0.8,
        held_out_gain=0.6,
        alike=("term.steering.throttle.even_square",),
    )
    text = text_of(case, found, replace(said, terms=[term]))
    assert kind.equation in text
    assert "6.7 rad/s²" in text
    assert "5.1 to 8.3" in text
    assert "the same: term.steering.throttle.even_square" in text
    entry = replace(said, terms=[term]).to_dict()["effects"][-1]
    assert (entry["kind"], entry["alike"]) == ("term", ["term.steering.throttle.even_square"])
