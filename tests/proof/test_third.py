"""The third sealed set: what its draw gives, and that nobody draws it without its secret."""

import gzip
import json
import re
from collections import Counter
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path

import pytest

from buggy_rl.core.config import from_plain
from buggy_rl.effects import EFFECTS
from buggy_rl.proof.baselines.asked import open_question
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.classes import CLASSES, class_of
from buggy_rl.proof.cases.draw import FIRST, DrawConfig, draw_all, drawn
from buggy_rl.proof.cases.drives import measured_car, plant_parameters
from buggy_rl.proof.cases.equivalents import expected
from buggy_rl.proof.cases.simulators import prepared_name
from buggy_rl.proof.cases.sizes import CAMERA, COMMANDED_SIZES, RALLY_SIZES, SIZES
from buggy_rl.proof.cases.term_forms import sorts_with_terms
from buggy_rl.proof.plants import PLANTS, abilities
from buggy_rl.proof.plants.rally.kinds import LIKE_THE_LIBRARY, UNKNOWN
from buggy_rl.proof.plants.rally.textbook import EFFECTS as TEXTBOOK
from buggy_rl.proof.score.oracle import described

ROOT = Path(__file__).parents[2]
SECRET = "a secret for tests alone"
RALLY = frozenset({*TEXTBOOK, *RALLY_SIZES})


@cache
def config() -> DrawConfig:
    import yaml

    content = yaml.safe_load((ROOT / "configs" / "proof_third.yaml").read_text())
    return from_plain(DrawConfig, content["draw"], "proof_third.yaml")


@cache
def third() -> tuple[Case, ...]:
    return tuple(drawn(config(), SECRET))


def foreign(cases):
    return [case for case in cases if not case.own_make]


def share(cases, among):
    return len(cases) / len(among)


def test_a_secret_decides_the_cases_and_without_one_the_seed_does():
    few = replace(config(), cases=40)
    assert drawn(few, SECRET) == list(third()[:40])
    for other in (drawn(few, "another"), drawn(few)):
        assert sum(a.concealed == b.concealed for a, b in zip(other, third(), strict=False)) < 12
    assert all(not case.salt for case in drawn(few))
    assert len({case.salt for case in third()}) == len(third())


def test_an_order_of_effects_depends_on_the_secret_too():
    each = DrawConfig(each=True, cases=0, pairings=["reference"])
    orders = [
        [c.truth for c in draw_all(each, {"reference": abilities("reference")}, secret)]
        for secret in ("", "one", "two")
    ]
    assert sorted(orders[0]) == sorted(orders[1])
    assert orders[0] != orders[1] != orders[2]


def test_the_numbers_of_a_car_depend_on_the_secret():
    # What a ledger shows before it is opened is the seed.
    seed = FIRST["third"]
    for plant in ("rally", "mujoco"):
        public = Case(seed, plant, "learned", spread=0.0 if plant == "rally" else 0.1)
        salted = replace(public, salt="0f")
        assert plant_parameters(salted) == plant_parameters(salted)
        shared = plant_parameters(salted).items() & plant_parameters(public).items()
        assert len(shared) < 4


def test_half_of_the_cases_are_of_another_make_and_a_third_of_those_without_baseline():
    assert len(third()) == 800
    assert share(foreign(third()), third()) >= 0.5
    alone = [case for case in foreign(third()) if not case.baseline]
    assert share(alone, foreign(third())) == pytest.approx(1 / 3, abs=0.06)
    assert {case.plant for case in third()} == set(PLANTS)
    made = {(case.simulator, case.baseline) for case in third() if case.plant == "rally"}
    assert len(made) == 5  # MuJoCo with a baseline alone


def _composed(case):
    return "term" if case.truth[0] in sorts_with_terms() else "composed"


def test_families_come_in_their_shares():
    count = Counter(
        _composed(case) if case.disturbances else "rally" if set(case.truth) & set(UNKNOWN)
        else case.family for case in third()
    )  # fmt: skip
    shares = {"nothing": 10, "one": 36, "two": 18, "three": 6, "rally": 12}
    # 90 of 558 sorts that are drawn at random have a term too.
    wanted = {**shares, "term": 13, "composed": 5}
    assert set(count) == set(wanted)
    for family, percent in wanted.items():
        mean = 7.2 * percent
        assert abs(count[family] - mean) < 3.5 * (mean * (1 - percent / 100)) ** 0.5


def test_classes_of_effects_are_balanced():
    count = Counter(class_of(case.truth[0]) for case in third() if case.family == "one")
    assert set(count) == set(CLASSES)
    assert max(count.values()) < 2 * min(count.values())
    # A control: effects drawn alike are far from that.
    alike = drawn(replace(config(), balanced=False), SECRET)
    count = Counter(class_of(case.truth[0]) for case in alike if case.family == "one")
    assert max(count.values()) > 2 * min(count.values())


def test_every_effect_that_can_be_drawn_has_one_class():
    entered = [effect for effects in CLASSES.values() for effect in effects]
    assert len(entered) == len(set(entered))
    assert set(entered) == {*SIZES, *COMMANDED_SIZES}
    assert set(EFFECTS) <= set(entered)
    with pytest.raises(KeyError, match="gremlin has no class"):
        class_of("gremlin")


def test_unknown_effects_are_the_rally_cars_and_those_that_have_a_name_are_not_drawn():
    kinds = {effect for case in third() for effect in case.truth if effect in RALLY_SIZES}
    assert 12 <= len(kinds) <= len(UNKNOWN)
    assert not kinds & set(LIKE_THE_LIBRARY)
    for case in third():
        if set(case.truth) & kinds:
            assert (case.plant, case.family, len(case.truth)) == ("rally", "unknown", 1)
    known = {*SIZES, *kinds}
    assert all(
        set(case.concealed) <= known or case.disturbances for case in third()
    )  # none of the reference car's own unknown kinds, which earlier ledgers have


def test_sizes_of_unknown_effects_are_spread_over_their_factors():
    settings = DrawConfig(cases=300, families=["rally"], pairings=["rally_learned"])
    below = []
    for case in draw_all(settings, {"rally": RALLY}):
        [(kind, values)] = case.concealed.items()
        low, high, _ = RALLY_SIZES[kind]["size"]
        assert low <= values["size"] <= high
        below.append(values["size"] < (low * high) ** 0.5)
    assert 0.4 < sum(below) / len(below) < 0.6  # the geometric mean is the median


def test_no_seed_stands_in_an_earlier_ledger():
    seeds, files = {case.seed for case in third()}, {*ROOT.rglob("docs/**/*.jsonl.gz")}
    # Cases of this set, opened.
    files -= {*(ROOT / "docs" / "development").glob("opened*.jsonl.gz")}
    texts = [gzip.decompress(file.read_bytes()).decode() for file in files]
    entered = {int(seed) for text in texts for seed in re.findall(r'"seed": (\d+)', text)}
    assert len(entered) > 100
    assert not seeds & entered
    assert min(seeds) == FIRST["third"]


def test_each_foreign_simulator_is_made_for_its_own_car():
    names = [prepared_name(case) for case in foreign(third())]
    assert len(set(names)) == len(names)
    assert all(case.id in name for case, name in zip(foreign(third()), names, strict=True))


def test_a_case_of_the_rally_car_is_scored_as_others_are():
    slope = {"floor_slope": {"along_x": 0.3, "along_y": -0.2}}
    case = Case(5, "rally", "mujoco_fitted", concealed=slope, salt="ab")
    assert not case.own_make
    assert case.differs_unseen
    assert expected(case, "floor_slope") == slope["floor_slope"]  # of the free car, as it is said
    assert described(case)
    unknown = replace(case, concealed={"wet_spill": {"size": 0.3}})
    assert unknown.family == "unknown"
    assert unknown.faults == {"wet_spill": {"size": 0.3}}
    assert not described(unknown)
    assert Case(**json.loads(json.dumps(asdict(case)))) == case


def test_the_owner_of_a_rally_car_measured_it():
    case = Case(5, "rally", "mujoco_fitted")
    numbers, car = plant_parameters(case), measured_car(case)
    assert car.vehicle.wheelbase == pytest.approx(numbers["wheelbase"], abs=1e-4)
    assert car.vehicle.mass == pytest.approx(numbers["mass"], abs=1e-4)
    assert car.vehicle.sensor_to_cg == 0.0
    assert car.steering.left == car.steering.right == pytest.approx(numbers["lock"], abs=1e-4)
    assert measured_car(Case(5, "mujoco", "learned")) is None


def test_camera_errors_of_a_rally_car_are_the_cameras():
    case = Case(5, "rally", "learned", concealed={"gyro_bias": {"bias": 0.1}})
    assert set(case.camera) == {CAMERA["gyro_bias"]["bias"]}
    assert not case.faults


def test_drives_that_the_reader_refuses_are_a_case_that_could_not_be_weighed(tmp_path):
    # As of a compass that the motor deflects: heading and yaw rate contradict each other.
    time = [0.01 * row for row in range(400)]
    rows = (f"{t:.2f},{2 * t},0.0,0.0,2.0,0.0,1.5,0.0,0.0" for t in time)
    text = "\n".join(["t,x,y,yaw,vx,vy,yaw_rate,throttle,steering", *rows])
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "drive_0.csv").write_text(text)
    (tmp_path / "question.yaml").write_text("{simulator: reference, recordings: [recordings]}")
    with pytest.raises(ValueError, match=r"recording .*yaw_rate"):
        open_question(tmp_path)
