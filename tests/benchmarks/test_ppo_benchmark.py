"""The training benchmark: its adapter on a task followed by hand, its cases for a few batches."""

import importlib
import json
import subprocess
import sys

import numpy as np
import pytest
import torch
from torchrl.envs import StepCounter, TransformedEnv

from tests.policies.test_ppo import LIMIT, Point

pytest.importorskip("stable_baselines3")

CARS = 4
SMALL = (
    "task.paths.count=5", "task.paths.validation_count=2", "task.paths.waypoints=60",
    "validation_steps=20",
)  # fmt: skip
OURS = ("configs/ppo.yaml", *SMALL, "ppo.cars=8", "ppo.batch_steps=16", "ppo.minibatch=64")
ORIGINAL = ("configs/ppo_original.yaml", *SMALL, "ppo.batch_steps=128")


@pytest.fixture(scope="module")
def part(request):
    """Imports a part of the benchmark as the script does, from its folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(request.config.rootpath / "benchmarks")
        yield lambda name: importlib.import_module(f"training.{name}")


@pytest.fixture
def cars(part):
    """Points on a line (x' = x + 0.4 u, beyond 1 they fail) as stable-baselines3 sees them."""

    def make(oldest=0):
        torch.manual_seed(0)
        env = TransformedEnv(Point(CARS), StepCounter(max_steps=LIMIT))
        return part("cars").CarsVecEnv(env, oldest)

    return make


@pytest.fixture
def settings(part):
    def read(case, *more):
        sources = ORIGINAL if case == "original" else OURS
        return part("cases").read_settings([*sources, *more], seed=0)

    return read


def pushed(*throttle):
    return np.array([[u, 0.0] for u in throttle], np.float32)


def test_a_car_that_fails_shows_its_last_observation_in_its_info(cars):
    env = cars()
    x = env.reset()
    assert x.shape == (CARS, 1)
    assert x.dtype == np.float32
    for _ in range(5):  # from -0.6 or above the fifth step of 0.4 is beyond 1 at the latest
        shown, reward, done, infos = env.step(pushed(1, 0, 0, 0))
        np.testing.assert_array_equal(done, [x[0, 0] + 0.4 > 1, False, False, False])
        np.testing.assert_array_equal(shown[1:], x[1:])
        last = x + np.array([[0.4], [0], [0], [0]], np.float32)
        np.testing.assert_allclose(reward, 1 - np.abs(last[:, 0] - 0.5), rtol=1e-6)
        if done[0]:
            break
        assert infos == [{}] * CARS
        x = shown
    assert done[0]
    np.testing.assert_allclose(infos[0]["terminal_observation"], last[0], rtol=1e-6)
    assert infos[0]["TimeLimit.truncated"] is False
    assert abs(shown[0, 0]) <= 0.6  # where the next episode begins
    assert infos[1:] == [{}] * (CARS - 1)


def test_an_episode_that_is_cut_off_says_so(cars):
    env = cars()
    x = env.reset()
    for step in range(1, LIMIT + 1):
        shown, _, done, infos = env.step(pushed(0, 0, 0, 0))
        assert done.tolist() == [step == LIMIT] * CARS
    for car in range(CARS):
        assert infos[car]["TimeLimit.truncated"] is True
        np.testing.assert_array_equal(infos[car]["terminal_observation"], x[car])
    assert not np.array_equal(shown, x)


def test_what_was_shown_is_not_overwritten_and_rewards_may_be_added_to(cars):
    env, other = cars(), cars()
    first = env.reset()
    kept = first.copy()
    _, reward, _, _ = env.step(pushed(0.5, 0, 0, 0))
    reward += 100.0
    _, reward, _, _ = env.step(pushed(0.5, 0, 0, 0))
    np.testing.assert_array_equal(first, kept)
    torch.manual_seed(0)
    other.reset()
    other.step(pushed(0.5, 0, 0, 0))
    np.testing.assert_array_equal(reward, other.step(pushed(0.5, 0, 0, 0))[1])


def test_first_episodes_can_begin_at_different_ages(cars):
    env = cars(oldest=LIMIT)
    env.reset()
    ends = [env.step(pushed(0, 0, 0, 0))[2] for _ in range(LIMIT)]
    count = np.sum(ends, 0)
    assert (count >= 1).all()  # none waits for longer than the limit
    assert len({int(np.argmax(car)) for car in np.transpose(ends)}) > 1


@pytest.mark.slow
@pytest.mark.parametrize("case", ["original", "batched", "ours"])
def test_each_case_trains_and_its_policy_can_be_scored(part, settings, case):
    cases, timing, score = part("cases"), part("timing"), part("score")
    run = settings(case, f"ppo.steps={cases.ENDLESS}")
    training = cases.CASES[case]("learned", 1, run)
    found, per_cpu_second = timing.rates(training, seconds=0.01, repeats=2)
    assert len(found) == 2
    assert min(*found, per_cpu_second) > 0
    closed = score.score(cases.validation_environment("learned", 1, run), training, 20)
    assert 0 <= closed < 20


def test_the_peers_settings_are_ours(part, settings):
    run = settings("batched")
    cases = part("cases")
    model, ours = (cases.CASES[case]("learned", 1, run) for case in ("batched", "ours"))
    model = model.model
    ppo = run.ppo
    assert (model.n_envs, model.n_steps) == (ppo.cars, ppo.batch_steps)
    assert (model.batch_size, model.n_epochs) == (ppo.minibatch, ppo.epochs)
    assert (model.gamma, model.gae_lambda) == (ppo.discount, ppo.trace)
    assert model.lr_schedule(0.25) == pytest.approx(0.25 * ppo.learning_rate)
    sizes = [sorted(p.shape for p in policy.parameters()) for policy in (model.policy, ours.policy)]
    assert sizes[0] == sizes[1]


@pytest.mark.slow
@pytest.mark.parametrize(("case", "limit"), [("ours", 60.0), ("batched", 0.0)])
def test_a_climb_ends_at_the_score_or_at_the_limit(part, settings, case, limit):
    run = settings(case)
    training = part("cases").CASES[case]("learned", 1, run)
    target = 0.0 if limit else 1000.0
    climb = part("score").climb(training, "learned", run, target, every=200, limit=limit)
    # A look after every 200 steps, at the end of a batch of 128; no time at all allows for one.
    assert (climb.reached, climb.steps) == ((True, 256) if limit else (False, 0))
    assert len(climb.curve) == 1


def test_a_profile_names_every_part_and_leaves_no_trace(part, settings):
    before = vars(torch.Tensor)["backward"]
    training = part("cases").Ours("learned", 1, settings("ours", "ppo.steps=1_000_000"))
    parts = part("breakdown").breakdown(training, seconds=0.05)
    assert {"engine", "transform Waypoints", "actor", "loss, forward", "loss, backward"} <= set(
        parts
    )
    assert min(parts.values()) > 0
    assert vars(torch.Tensor)["backward"] is before
    assert "step_and_maybe_reset" not in vars(training.ppo.env)


def test_the_floor_counts_the_products_of_model_and_policy(part, settings):
    run = settings("ours", "policy.hidden=[4]", "ppo.epochs=2", "ppo.steps=1_000_000")
    floor = part("floor").floor(part("cases").Ours("learned", 1, run), seconds=0.02)
    adds = {name: row["multiply_adds"] for name, row in floor.items()}
    assert adds == {
        "learned engine": 25 * 64 + 64 * 64 + 64 * 3,
        "actor, collecting": 23 * 4 + 4 * 2,
        "critic, advantages": 23 * 4 + 4,
        # 3 products a layer, but 2 in the first, which has no gradient of its input; twice
        "actor, learning": 2 * (2 * 23 * 4 + 3 * 4 * 2),
        "critic, learning": 2 * (2 * 23 * 4 + 3 * 4),
    }
    assert all(row["microseconds"] > 0 for row in floor.values())


@pytest.mark.slow
def test_the_script_leaves_a_table_and_figures(repository, tmp_path):
    def listed(sources):
        return f"[{','.join(sources)}]"

    command = [
        *(sys.executable, "benchmarks/ppo.py", "simulators=[learned]", "threads=[1]", "rounds=1"),
        *("repeats=1", "seconds=0.01", "cases=[ours]", f"ours={listed(OURS)}"),
        f"output={tmp_path / 'ppo.json'}",
    ]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True)
    assert "| learned | 1 | ours |" in done.stdout
    (row,) = json.loads((tmp_path / "ppo.json").read_text())["rows"]
    assert row["rates"][0] > 0
