"""A slow simulator gets fewer rollouts, not a longer wait; what is lost is said."""

import math
from dataclasses import replace

import pytest

from buggy_rl.diagnosis.run.budget import FULL, LEAST_SEGMENTS, Budget, smaller
from buggy_rl.diagnosis.run.meter import Meter
from buggy_rl.diagnosis.run.plan import (
    LEARNED,
    Plan,
    Question,
    planned,
    planned_rollouts,
    shortest,
)
from buggy_rl.estimation.cost import Cost
from buggy_rl.estimation.residual_process import ITERATIONS

QUESTION = Question(segments=60, rows=130, trials=120, longer=28)
FAST = Cost(fixed=3e-4, each=1e-7, effects=1e-3)
BATCHED = Cost(fixed=0.08, each=1.4e-5)  # 20 times the reference car
SERIAL = Cost(fixed=1e-5, each=2e-4)  # one environment at a time


def test_a_fast_simulator_gets_everything_and_nothing_is_said():
    plan = planned(QUESTION, FAST, 10.0)
    assert plan.budget == FULL
    assert plan.notes == ()
    assert plan.seconds < 60


@pytest.mark.parametrize("cost", [BATCHED, SERIAL])
def test_a_slow_one_gets_so_little_that_it_ends_in_time_and_the_loss_is_said(cost):
    plan = planned(QUESTION, cost, 10.0)
    assert plan.budget != FULL
    assert plan.seconds <= 600
    [note] = plan.notes
    assert f"{plan.budget.segments(60)} of 60 segments, {plan.budget.sets} of 16 sets" in note
    assert note.endswith("intervals are wider; minutes=0 leaves nothing out")


def test_one_that_cannot_end_in_time_gets_the_least_and_is_told_how_long_it_takes():
    plan = planned(QUESTION, replace(SERIAL, each=0.1), 10.0)
    assert plan.budget == [*smaller()][-1]
    assert "minutes are expected, more than minutes=10" in plan.notes[-1]


def test_the_least_has_no_second_look_and_no_longer_errors_and_says_so():
    plan = planned(QUESTION, replace(BATCHED, fixed=0.2), 10.0, spent=500.0)
    assert (plan.budget.rounds, plan.budget.refitted, plan.budget.longer) == (0, 0, False)
    assert plan.budget.terms == 0
    for part in (
        "0 of 5 rounds",
        "0 of 12 sets fitted on at the end",
        "held-out residuals to first order",
        "no errors beyond 1 s",
        "no equations without a name",
    ):
        assert part in plan.notes[0]
    assert not any(r.rows > QUESTION.rows for r in plan.rollouts)


def test_time_that_has_passed_is_not_planned_with():
    early, late = (planned(QUESTION, BATCHED, 15.0, spent).seconds for spent in (0.0, 450.0))
    assert late < 450 < early


def test_by_two_processes_an_answer_is_proved_in_half_of_the_rollouts():
    alone, beside = ([*planned_rollouts(QUESTION, FULL, n)] for n in (1, 2))
    times = [
        sum(r.times for r in each if r.stage == "answer" and r.part != "terms")
        for each in (alone, beside)
    ]
    learned = LEARNED * ITERATIONS
    assert times == [4 + 10 + learned + 2, 4 + 5 + learned + 1]


def test_a_slow_reset_is_told_with_its_price_in_steps():
    assert planned(QUESTION, replace(FAST, reset=1e-3), 10.0).notes == ()
    [note] = planned(QUESTION, replace(FAST, reset=2.0), 0.0).notes
    assert note.startswith("a reset of the simulator takes 2 s, as long as 5695 of its steps")


def test_without_a_limit_everything_is_rolled_out():
    assert planned(QUESTION, SERIAL, 0.0).budget == FULL


def test_where_the_batch_costs_nothing_segments_are_kept_and_else_rollouts():
    assert planned(QUESTION, replace(BATCHED, each=0.0), 10.0).budget.share == 1.0
    serial = planned(QUESTION, SERIAL, 10.0).budget
    assert (serial.rounds, serial.iterations) == (FULL.rounds, FULL.iterations)
    assert serial.share < 1.0


def test_the_least_budget_takes_a_small_part_of_the_time():
    for cost in (BATCHED, SERIAL):
        plans = [Plan(b, cost, tuple(planned_rollouts(QUESTION, b))).seconds for b in smaller()]
        assert plans[-1] == min(plans) < 0.5 * plans[0]


def test_workers_shorten_what_is_large_and_leave_what_is_small():
    two = replace(SERIAL, workers=2)
    assert two.seconds(10_000, 100) == pytest.approx(0.5 * SERIAL.seconds(10_000, 100), rel=1e-2)
    assert two.seconds(16, 100) == SERIAL.seconds(16, 100)
    both = replace(BATCHED, workers=2)
    assert both.seconds(1000, 100) == BATCHED.seconds(1000, 100)  # its fixed time is not divided


def test_few_segments_are_never_thinned_below_what_can_be_held_out():
    assert Budget(share=0.1).segments(60) == LEAST_SEGMENTS
    assert Budget(share=0.1).segments(7) == 7


def test_the_meter_knows_the_time_left_from_the_start_and_learns_the_speed():
    shown = []
    plan = planned(QUESTION, BATCHED, 10.0)
    meter = Meter(shown.append, lambda _: None)
    meter.rolled(10, 10)  # before there is a plan nothing is counted
    assert shown == []
    meter.begin(plan)
    assert shown[-1].done == 0
    assert shown[-1].left == pytest.approx(plan.seconds)
    meter.stage("answer")
    seconds, steps = plan.before("answer")
    assert shown[-1].done == 0
    assert shown[-1].planned == plan.steps - steps
    assert shown[-1].left == pytest.approx(plan.seconds - seconds)
    meter.rolled(1_000_000, 1000)  # far beyond the plan: no time is left, and no step is lost
    assert shown[-1].left == 0.0
    assert shown[-1].planned == shown[-1].done == 1_000_000_000


def test_a_search_beyond_its_plan_leaves_the_answer_its_share():
    shown, plan = [], planned(QUESTION, BATCHED, 10.0)
    meter = Meter(shown.append, lambda _: None)
    meter.begin(plan)
    meter.stage("search")
    meter.rolled(1_000_000, 1000)
    _, before = plan.before("answer")
    assert shown[-1].planned - shown[-1].done == plan.steps - before > 0
    assert shown[-1].left > 0


def test_the_share_that_is_shown_is_of_the_time_and_not_of_the_steps(monkeypatch):
    now, shown = [0.0], []
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    plan = planned(QUESTION, replace(BATCHED, each=0.0), 0.0)  # a step of few takes as long
    meter = Meter(shown.append, lambda _: None)
    meter.begin(plan)
    for rollout in (r for r in plan.rollouts if r.stage != "answer"):
        for _ in range(rollout.times):
            now[0] += plan.cost.seconds(rollout.environments, rollout.rows)
            meter.rolled(rollout.environments, rollout.rows)
    meter.stage("answer")
    last, seconds = shown[-1], plan.before("answer")[0]
    proved = sum(r.steps for r in plan.rollouts if r.stage == "answer" and r.part != "terms")
    assert last.planned == last.done + proved + _steps(plan, "terms")
    assert last.left == pytest.approx(plan.seconds - seconds, rel=0.05)
    assert last.share < 0.9
    assert last.share == pytest.approx(seconds / plan.seconds, abs=0.03)


def test_a_machine_that_gets_busy_and_idle_again_changes_the_time_left_soon(monkeypatch):
    now, shown = [0.0], []
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    plan = planned(QUESTION, BATCHED, 10.0)
    meter = Meter(shown.append, lambda _: None)
    meter.begin(plan, "search")
    each = plan.seconds / 200
    rows = round(each / (BATCHED.fixed + BATCHED.each))
    for slower in [1.0] * 60 + [3.0] * 50 + [1.0] * 50:
        now[0] += slower * plan.cost.seconds(1, rows)
        meter.rolled(1, rows)
    assert meter.slower == pytest.approx(1.0, abs=0.05)


def test_sets_that_limits_add_are_planned_with():
    plans = [planned(replace(QUESTION, limits=n), BATCHED, 0.0) for n in (0, 1)]
    first, second = ([r for r in plan.rollouts if r.stage == "search"] for plan in plans)
    assert len(second) > len(first)
    assert plans[1].steps > plans[0].steps


def test_a_search_whose_findings_count_for_nothing_gets_the_smallest_budget_and_says_why():
    plan = shortest(QUESTION, FAST, "because")
    assert plan.budget == [*smaller()][-1]
    assert plan.notes == ("because",)
    assert plan.seconds < 0.2 * planned(QUESTION, FAST, 10.0).seconds


def test_what_a_part_needs_leaves_time_for_what_must_follow():
    plan = planned(QUESTION, BATCHED, 0.0)
    longer, terms = (_seconds(plan, part) for part in ("longer", "terms"))
    answer = plan.seconds - plan.before("answer")[0] - longer - terms
    refitted, one = plan.needed("refitted"), plan.needed("first_round")
    assert plan.needed("longer") == pytest.approx(answer + longer)
    assert plan.needed("terms") == pytest.approx(answer + longer + terms)
    assert 0.0 == plan.needed("experiments") < answer < refitted
    # The first round goes before fitting on at the end; the second leaves time for that.
    assert plan.needed("round") == pytest.approx(one + refitted - answer)
    rounds = 2 * (plan.needed("round") - refitted)
    whole = plan.seconds - plan.before("search")[0] - longer - terms
    apart = whole - rounds - (refitted - answer)
    assert plan.needed("retuning") == pytest.approx(apart)


def _steps(plan, part):
    return sum(r.steps for r in plan.rollouts if r.part == part)


def _seconds(plan, part):
    return sum(plan._seconds(r) for r in plan.rollouts if r.part == part)


def test_on_a_machine_three_times_slower_than_planned_a_part_is_admitted_a_third_as_late(
    monkeypatch,
):
    now = [0.0]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    plan = planned(QUESTION, BATCHED, 0.0)
    meter = Meter(lambda _: None, lambda _: None)
    assert meter.admits("round")  # no plan: nothing is left out
    rows = round(plan.seconds / 10 / (BATCHED.fixed + BATCHED.each))

    def begun(deadline, slower):
        now[0] = 0.0
        meter.begin(plan, "search", deadline)
        for _ in range(3):
            now[0] += slower * plan.cost.seconds(1, rows)
            meter.rolled(1, rows)
        return meter.admits("round")

    for slower in (1.0, 3.0):
        spent = 3 * slower * plan.cost.seconds(1, rows)
        needed = slower * plan.needed("round")
        assert begun(spent + 1.01 * needed, slower)
        assert not begun(spent + 0.99 * needed, slower)
    assert begun(math.inf, 1e6)
