"""The page for the driver: whole in itself, true to the answer, honest whatever the verdict."""

import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest
import torch
from torchrl.envs import TransformedEnv

from buggy_rl.diagnosis.answer import Answer, Named, Proof, Value
from buggy_rl.diagnosis.case import prepared
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.localisation import Region, locate
from buggy_rl.diagnosis.report import causes, report, sections, wording
from buggy_rl.diagnosis.report.errors import errors
from buggy_rl.diagnosis.report.markup import Bar, Markup, bars, escaped, tag
from buggy_rl.diagnosis.report.ranking import losers, ranking
from buggy_rl.diagnosis.report.replays import replays
from buggy_rl.diagnosis.search import Found, Search
from buggy_rl.diagnosis.unexplained import remaining
from buggy_rl.effects import effect_class, make_effect
from buggy_rl.engines import make_engine
from buggy_rl.estimation.gauss_newton import Fitter
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.rollout import Player
from buggy_rl.policies.controllers.recording import driven
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.recordings import Recording
from buggy_rl.recordings.camera import Camera, CameraConfig

GAIN = 0.7
NAME = 'drive <b>"1"</b> & $x_1'
VOID = {"meta", "br", "use"}


def weaker_steering(cars):
    """A single-track car whose steering turns the wheels by less than the simulator thinks."""
    gain = make_effect("steering_gain", {"gain": GAIN})
    return TransformedEnv(make_engine("single_track", cars), gain)


@torch.no_grad()
def drives(seconds=5.0):
    """Three at once: each is a block of its own when blocks are held out."""
    rows = list(driven(weaker_steering(3), RoomDriver(seed=3), round(seconds / 0.01)))
    true = torch.stack(rows, 1)  # (3, T)
    names = (NAME, "second", "third")
    return [
        Recording(name, Camera(CameraConfig(), car).recorded(true[car]), 0.01)
        for car, name in enumerate(names)
    ]


def found_in(case):
    """A search that tried two causes, and what it came to."""
    search = Search(Fitter(case.player, case.cut, case.likelihood, case.library))
    starts = [
        search.fitter.start(causes) for causes in ((), ("steering_gain",), ("steering_offset",))
    ]
    search.null, best, _ = search.fit(starts)
    return search, Found(search.null, best, search.tried)


def said_of(case, search, found):
    """The answer, with round numbers where it would take long to prove them."""
    instants = case.player.instants(case.cut)
    rest = remaining(case.cut, instants, found.null.fitted.white, found.best.fitted.white)
    gain = found.best.fitted.values()["steering_gain"]["gain"]
    kind = effect_class("steering_gain")
    named = Named(
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
    where = locate(case.player, case.cut, case.likelihood.noise, case.names)
    return Answer("missing_physics", where, [named], rest, proof, ["no <jumps>"], ["slalom & stop"])


@pytest.fixture(scope="module")
def diagnosis():
    """A case, its search, what it found, and the answer."""
    library = Library(["steering_gain", "steering_offset"])
    config = DiagnosisConfig(simulator="single_track", recordings=[], output="")
    player = Player(lambda cars: make_engine("single_track", cars))
    case = prepared(player, drives(), library, config)
    search, found = found_in(case)
    return case, search, found, said_of(case, search, found)


@pytest.fixture(scope="module")
def page(diagnosis):
    return report(*diagnosis)


def with_simulator(case, make):
    return replace(case, player=replace(case.player, make=make))


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
    assert all(r.startswith(("#", "data:image/png;base64,")) for r in read.references)


def test_the_page_is_well_formed_and_fits_a_phone(page):
    assert Page(page).open == []
    assert page.startswith("<!doctype html>")
    assert 'name="viewport"' in page
    assert "@media print" in page
    assert len(page) < 2_000_000


def test_the_sentence_and_the_numbers_are_on_it(diagnosis, page):
    _, _, _, said = diagnosis
    text = Page(page).text
    for line in said.lines():
        assert line in text
    (effect,) = said.effects
    assert effect.name == "steering_gain"
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


def test_pictures_show_measured_simulated_and_repaired(diagnosis, page):
    assert page.count("<svg") == 5  # three stretches, the room, speed over steering
    assert "repaired" in Page(page).text
    shown = replays(diagnosis[0], diagnosis[2])
    assert len(shown) == 3
    for replay in shown[:2]:
        off, better = (
            abs(motion[:, 5] - replay.measured[:, 5]).mean()
            for motion in (replay.simulated, replay.repaired)
        )
        assert better < 0.5 * off


def test_a_replay_begins_where_the_car_was(diagnosis):
    for replay in replays(diagnosis[0], diagnosis[2]):
        # One row on: 10 ms at no more than 4 m/s is 40 mm, and 5 mm for noise.
        assert abs(replay.measured[0, :2]).max() < 0.045
        assert abs(replay.simulated[0, :2] - replay.measured[0, :2]).max() < 0.01


def test_errors_of_a_right_simulator_are_the_noise(diagnosis):
    case, _, _, said = diagnosis
    before = errors(case)
    after = errors(with_simulator(case, weaker_steering))
    assert (after.size**2).mean() == pytest.approx(1.0, abs=0.25)
    assert (before.size**2).mean() > 3.0
    assert len(said.located.channel_share) == 3


def test_what_was_chosen_leads_the_ranking_and_every_loser_is_worse(diagnosis):
    _, search, found, _ = diagnosis
    ranks = ranking(search, found, 5)
    assert ranks[0].chosen
    assert ranks[0].causes == ("steering_gain",)
    assert [r.nats for r in ranks] == sorted((r.nats for r in ranks), reverse=True)
    lost = dict(losers(search, found, "steering_gain"))
    assert set(lost) == {"", "steering_offset"}
    assert min(lost.values()) > 0
    assert lost[""] == pytest.approx(ranks[0].nats)  # nothing in its place is the null


@pytest.mark.parametrize("verdict", list(wording.VERDICTS))
def test_every_verdict_says_what_it_means(diagnosis, verdict):
    shown = replace(diagnosis[3], verdict=verdict)
    text = Page(sections.verdict(shown)).text
    assert wording.MEANINGS[verdict] in text
    assert wording.VERDICTS[verdict] in text
    assert shown.lines()[0] in text
    assert "93% sure" in text


def test_of_a_simulator_that_was_re_tuned_the_page_tells_what_it_had(diagnosis):
    case, _, _, said = diagnosis
    given = case.player.make(1).declared["mass"].value

    def tuned(cars):
        return make_engine("single_track", cars, parameters={"mass": 2 * given})

    own = {"mass": tuned(1).declared["mass"]}
    again = replace(
        case,
        player=replace(case.player, make=tuned),
        library=Library(case.library.effects, own, own=False),
        retuned_from=case.player,
    )
    assert case.as_given is case.library
    assert again.as_given.numbers("parameter:mass")[0].value == given
    value = Value(2 * given, 1.9 * given, 2.1 * given, "kg")
    mass = replace(
        said.effects[0], name="parameter:mass", kind="parameter", parameters={"mass": value}
    )
    text = Page(causes.named(again.as_given, [mass], retuned=True)).text
    assert f"{given:.3g} kg" in text
    assert "of the gap together" in text


@pytest.mark.parametrize("verdict", ["no_mismatch", "unknown_physics"])
def test_where_nothing_is_named_the_page_names_nothing(diagnosis, verdict):
    case, search, found, said = diagnosis
    shown = replace(said, verdict=verdict, effects=[])
    bare = Found(found.null, found.null, found.tried)
    text = Page(report(case, search, bare, shown)).text
    assert wording.MEANINGS[verdict] in text
    assert "Nothing is named." in text
    assert "None was chosen" in text
    assert "Nothing was named, so there is no repaired simulator to show." in text
    assert "sure" not in text.replace("measured", "")


def test_a_rival_that_cannot_be_told_apart_is_not_among_the_losers(diagnosis):
    _, search, found, said = diagnosis
    effect = replace(said.effects[0], confused_with={"steering_offset": 0.31})
    text = Page(causes.excluded(search, found, [effect])).text
    assert "steering offset, 31%" in text
    assert "steering offset: worse by" not in text
    assert "steering offset: worse by" in Page(causes.excluded(search, found, said.effects)).text


def test_parameters_that_were_re_tuned_together_have_no_rivals_that_lost(diagnosis):
    _, search, found, said = diagnosis
    mass = replace(said.effects[0], name="parameter:mass", kind="parameter")
    text = Page(causes.excluded(search, found, [mass])).text
    assert "re-tuned all at once" in text
    assert "Tried and lost" not in text
    assert "In place of" not in text


def test_a_value_at_its_bound_is_no_more_than_a_hint(diagnosis):
    case, _, _, said = diagnosis
    at_end = replace(said.effects[0], at_bound=("gain",))
    assert "gain lies at the end of its range" in Page(causes.named(case.library, [at_end])).text
    assert "end of its range" not in Page(causes.named(case.library, said.effects)).text


def test_a_name_whose_numbers_are_not_the_same_everywhere_is_said_to_be_a_lookalike(diagnosis):
    case, _, _, said = diagnosis
    lookalike = replace(said.effects[0], varies_with="abs_steering")
    text = Page(causes.named(case.library, [lookalike])).text
    assert "they change with how far is steered" in text
    assert "resembles" not in Page(causes.named(case.library, said.effects)).text


def test_a_simulator_that_gives_no_numbers_is_drawn_as_far_as_it_goes(diagnosis):
    case, search, found, said = diagnosis

    class Broken(type(make_engine("single_track", 1))):
        def _step(self, tensordict):
            result = super()._step(tensordict)
            result["velocity"][..., 0] = float("nan")
            return result

    broken = with_simulator(case, lambda cars: Broken(cars))
    proof = Proof({1.0: float("nan")}, {1.0: 0.01}, {}, {}, {}, float("nan"), 1.0, False)
    shown = replace(said, proof=replace(said.proof, **vars(proof)))
    shown = replace(shown, notes=["the simulator broke <off>"])
    text = Page(report(broken, search, found, shown)).text
    assert "–" in text
    assert "nothing could be held out" in text
    assert "the simulator broke <off>" in text


def test_the_same_case_makes_the_same_page(diagnosis, page):
    assert report(*diagnosis) == page


def test_a_parameter_of_the_simulator_is_called_so():
    assert wording.cause("parameter:front_friction") == "the simulator's front friction"
    assert wording.cause("my/file.py:StickyServo") == "StickyServo"
    assert wording.cause("") == "the simulator as given"


def test_small_shares_are_not_rounded_to_none():
    assert wording.percent(0.0) == "0%"
    assert wording.percent(0.001) == "under 1%"
    assert wording.percent(0.314) == "31%"


def test_bars_stay_in_their_track_and_text_is_escaped_once():
    drawn = bars([Bar("a < b", 3.0, "3"), Bar("c", -1.0, "-1"), Bar("d", float("nan"), "?")])
    assert re.findall(r"width:([\d.]+)%", drawn) == ["100.0", "0.0", "0.0"]
    assert "a &lt; b" in drawn
    assert escaped(escaped("<")) == "&lt;"
    assert tag("p", Markup("<i>")) == "<p><i></p>"


def test_a_region_is_said_in_words_and_everyday_units():
    # pi/2 rad is 90 degrees; 0.25 and 0.5 of a command have no unit.
    found = Region({"heading": (0.0, math.pi / 2), "steering": (0.25, 0.5)}, 0.62, 0.1)
    assert wording.region(found) == (
        "Heading 0 to 90 ° and steering command 0.25 to 0.5: 62% of the error in 10% of the driving"
    )


def test_only_a_lag_that_was_found_is_told():
    lags = {"steering": {"yaw_rate": 0.06, "vx": math.nan}, "throttle": {"vx": math.nan}}
    assert wording.lags(lags) == [
        "Errors in turning (yaw rate) come about 60 ms after the steering moves"
    ]


@pytest.mark.parametrize(
    ("verdict", "decided"), [("missing_physics", True), ("cannot_tell", False)]
)
def test_only_an_answer_that_is_one_says_that_all_is_decided(diagnosis, verdict, decided):
    silent = replace(diagnosis[3], verdict=verdict, weak=[], suggest=[])
    assert ("decide all that was asked" in Page(sections.following(silent)).text) == decided


def test_a_value_keeps_its_unit_and_its_interval():
    value = Value(0.0612, 0.055, 0.067, "m/s^2")
    assert wording.interval(value.low, value.high, value.unit) == "0.055 to 0.067 m/s²"
