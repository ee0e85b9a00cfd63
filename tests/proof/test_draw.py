"""Drawing: one seed, one case; honest shares; ranges that are nobody's prior."""

from collections import Counter
from dataclasses import replace

import pytest

from buggy_rl.effects import EFFECTS, effect_class
from buggy_rl.proof.cases.draw import PAIRINGS, PUBLISHED, REFITTED, DrawConfig, draw, draw_all
from buggy_rl.proof.cases.sizes import CAMERA, NAMED_SINCE, RALLY_SIZES, SIZES, UNKNOWN_SIZES
from buggy_rl.proof.plants import PLANTS, abilities
from buggy_rl.proof.plants.composed import SORTS, UNNAMED, WHERE, Sort
from buggy_rl.simulators.reference.faults import TEXTBOOK, UNKNOWN

CAR = frozenset(fault.name.partition(".")[0] for fault in (*TEXTBOOK, *UNKNOWN))
ABLE = {"reference": CAR, "mujoco": CAR - set(UNKNOWN_SIZES), "commonroad": CAR}
ABLE["rally"] = abilities("rally")
OLD = ("reference", "mujoco_fitted", "dropped", ("tire_grip", "top_speed"), "steady", 20.0, 0.0)
COMPOSED = DrawConfig(cases=300, families=["composed"])
MANY = draw_all(DrawConfig(cases=600), ABLE)


def test_every_effect_of_the_library_and_every_fault_of_a_car_has_a_range():
    assert set(SIZES) == set(EFFECTS)
    assert CAR | set(CAMERA) == set(SIZES) | set(UNKNOWN_SIZES)
    for plant in PLANTS:
        assert abilities(plant) <= set(SIZES) | set(UNKNOWN_SIZES) | set(RALLY_SIZES)


def test_ranges_are_not_the_librarys():
    for effect, sizes in SIZES.items():
        known = {p.name: p for p in effect_class(effect).declared}
        for name, size in sizes.items():
            parameter = known[name]
            assert (size.low, size.high) != (parameter.lower, parameter.upper)
            assert parameter.lower <= size.low < size.high <= parameter.upper
            # Nothing that is concealed is as small as nothing; a patch's place may be anywhere.
            if (effect, name) not in (("grip_patch", "x"), ("grip_patch", "y")):
                assert not size.low <= parameter.value <= size.high
            assert len(size.why) > 5


def test_one_seed_is_one_case():
    assert draw_all(DrawConfig(cases=30), ABLE) == MANY[:30]
    assert draw(3, DrawConfig(), ABLE) != draw(4, DrawConfig(), ABLE)


def test_sizes_lie_in_their_ranges_with_either_sign():
    signs = set()
    for case in MANY:
        for effect, values in case.concealed.items():
            for name, value in values.items():
                size = (SIZES | UNKNOWN_SIZES)[effect][name]
                assert size.low <= (abs(value) if size.signed else value) <= size.high
                if (effect, name) == ("gyro_bias", "bias"):
                    signs.add(value > 0)
    assert signs == {True, False}


def test_half_the_cases_are_not_of_the_simulators_make():
    assert sum(case.plant != case.simulator for case in MANY) >= 300
    # And nothing rests on luck: the pairings drawn from say so.
    drawn = DrawConfig().pairings
    own = [p for p in drawn if PAIRINGS[p].plant == PAIRINGS[p].simulator]
    assert len(own) <= len(drawn) / 2


def test_families_come_in_their_shares():
    # 600 cases, 9 of 20 with one effect: 270, standard deviation sqrt(600 .45 .55) = 12.2.
    count = Counter(case.family for case in MANY)
    assert abs(count["one"] - 270) < 4 * 12.2
    assert abs(count["nothing"] - 150) < 4 * 10.6
    assert abs(count["two"] - 90) < 4 * 8.7
    assert abs(count["unknown"] - 60) < 4 * 7.3
    assert abs(count["three"] - 30) < 4 * 5.3


def test_what_a_plant_cannot_have_is_not_asked_of_it():
    for case in MANY:
        assert set(case.faults) <= ABLE[case.plant]
    with pytest.raises(ValueError, match="can have unknown"):
        draw(1, DrawConfig(families=["unknown"], pairings=["mujoco"]), ABLE)


def test_wrong_parameters_are_a_nuisance_only_beside_a_baseline():
    off = [case for case in MANY if case.nuisance.startswith("parameters")]
    assert off
    assert all(case.baseline for case in off)
    assert not any(case.simulator == "learned" for case in off)


def test_each_effect_once_in_an_order_that_tells_nothing():
    settings = DrawConfig(each=True, cases=0, nothing=20, pairings=["reference"])
    cases = draw_all(settings, ABLE)
    alone = [case.truth[0] for case in cases if case.truth]
    assert sorted(alone) == sorted(SIZES)
    assert len(cases) == len(SIZES) + 20
    assert alone != list(SIZES)
    assert cases == draw_all(settings, ABLE)


def test_sealed_seeds_are_no_development_seeds():
    sealed = draw_all(DrawConfig(split="sealed", cases=50), ABLE)
    assert not {case.seed for case in sealed} & {case.seed for case in MANY}
    with pytest.raises(ValueError, match="development, sealed"):
        DrawConfig(split="test")


def test_composed_physics_is_drawn_from_all_places_and_is_unknown():
    cases = draw_all(DrawConfig(cases=300, families=["composed"]), ABLE)
    sorts = [Sort.named(case.truth[0]) for case in cases]
    assert {sort.where for sort in sorts} == set(WHERE)
    assert len({str(sort) for sort in sorts}) > 100
    assert {case.family for case in cases} == {"unknown"}
    assert all(case.truth[0] in SORTS for case in cases)
    assert all(not case.faults and not case.camera for case in cases)


def test_fresh_development_cases_have_the_effects_of_today():
    fresh = draw_all(DrawConfig(cases=600, library="present"), ABLE)
    drawn = {effect for case in fresh for effect in case.concealed}
    assert {"understeer", "steering_drag", "torque_steer", "stiff_differential"} <= drawn
    assert {"cornering_stiffness", "dive_steer", "pose_scale", "heading_drift"} <= drawn
    assert not set(NAMED_SINCE) & drawn
    assert not (set(SIZES) - PUBLISHED) & {effect for case in MANY for effect in case.concealed}
    sorts = {c.truth[0] for c in draw_all(replace(COMPOSED, library="present"), ABLE)}
    assert sorts <= set(UNNAMED)


def test_a_plant_is_drawn_only_where_its_simulator_is_its_own_or_fitted_anew():
    cases = draw_all(DrawConfig(cases=200, spread=[0.1], pairings=list(PAIRINGS)), ABLE)
    for case in cases:
        drawn = case.simulator in REFITTED and case.plant != "rally"  # whose are drawn anyway
        assert bool(case.spread) == drawn
    assert len({case.spread for case in cases}) == 2
    each = DrawConfig(cases=60, spread=[0.1], pairings=list(PAIRINGS), fitted_to_each=True)
    assert all(case.own_car for case in draw_all(each, ABLE))


def test_older_draws_are_as_they_were():
    # Published hashes are of such cases: what came later may not change them.
    case = draw(11, DrawConfig(), ABLE)
    assert (case.plant, case.simulator, case.nuisance) == OLD[:3]
    assert (case.truth, case.driving, case.seconds, case.spread) == OLD[3:]
