"""Actors and critics of one's own: those of docs/policies.md, trained, saved, driven, refused."""

import math
import re
from itertools import islice
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import StepCounter, TransformedEnv

from buggy_rl.core.files import save_torch
from buggy_rl.export.export import Export, ExportConfig
from buggy_rl.policies.training.actor_critic import Policy, PolicyConfig, load_policy, save_policy
from buggy_rl.policies.training.checkpoint import load_checkpoint
from buggy_rl.policies.training.collecting import CollectorConfig
from buggy_rl.policies.training.ppo import PPO
from buggy_rl.policies.training.run import PolicyRunConfig, new_batches, policy_question
from tests.policies.test_ppo import LIMIT, STEPS, Point, config, curve, point

MORE = """

from torchrl.modules import LSTMModule, ValueOperator


def long_memory(size, config):
    memory = LSTMModule(input_size=size, hidden_size=8, in_keys=["observation", "h", "c"],
                        out_keys=["features", ("next", "h"), ("next", "c")])
    layers = nn.Sequential(nn.Linear(8, 4), NormalParamExtractor(scale_lb=0.05))
    return drawn(memory, TensorDictModule(layers, ["features"], ["loc", "scale"]))


def value(size, config):
    return ValueOperator(nn.Linear(size, 1), ["observation"])


def silent(size, config):
    layers = nn.Sequential(nn.Linear(size, 4), NormalParamExtractor())
    module = TensorDictModule(layers, ["observation"], ["loc", "scale"])
    return ProbabilisticActor(module, ["loc", "scale"], distribution_class=TanhNormal)


def broken(size):
    pass


def other(size, config):
    return nn.Linear(size, 2)
"""
RECURRENT = ["recurrent", "long_memory"]


@pytest.fixture
def file(tmp_path, repository, monkeypatch):
    """The file of the documentation, and more, in the working folder."""
    page = (repository / "docs" / "policies.md").read_text()
    (code,) = re.findall(r"File `my_actor.py`:\n\n```python\n(.*?)```", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    Path("my_actor.py").write_text(code + MORE)
    return "my_actor.py"


def run_of(file, kind, **settings):
    torch.manual_seed(1)
    policy = Policy(1, PolicyConfig(actor=f"{file}:{kind}", hidden=[8]))
    return PPO(point(), policy, config(**settings))


@pytest.mark.parametrize("kind", ["squashed", *RECURRENT])
def test_it_is_trained_and_its_commands_stay_within_their_limits(file, kind):
    run = run_of(file, kind)
    before = {name: tensor.clone() for name, tensor in run.policy.state_dict().items()}
    batch = run.collector.rollout()
    assert batch["action"].abs().max() <= 1
    assert batch["scale"].min() >= 0.05
    rows = list(run.run())
    assert all(math.isfinite(rows[-1][n]) for n in ("loss_objective", "loss_critic", "sd_steering"))
    changed = [
        name for name, old in before.items() if not torch.equal(old, run.policy.state_dict()[name])
    ]
    assert {name.partition(".")[0] for name in changed} >= {"own_actor", "value_layers"}


@pytest.mark.parametrize("kind", ["squashed", *RECURRENT])
def test_a_resumed_run_of_it_gives_the_same_curve_bit_for_bit(file, kind, tmp_path):
    whole, rows = run_of(file, kind), []
    for metrics in whole.run():
        rows.append(metrics)
        if len(rows) == 2:
            save_torch(tmp_path / "checkpoint.pt", whole.state_dict())
    again = run_of(file, kind)
    again.load_state_dict(load_checkpoint(tmp_path / "checkpoint.pt"))
    assert curve(again.run()) == curve(rows[2:])


@pytest.mark.parametrize("kind", RECURRENT)
def test_what_is_learned_from_is_what_was_driven_across_ends_of_episodes(file, kind):
    run = run_of(file, kind)
    list(islice(run.run(), 1))  # whose last states the next batch begins with
    batch = run.collector.rollout()
    with torch.no_grad():
        run.estimate(batch)
    ends = batch["is_init"][:, 1:]
    assert ends.any()
    assert not ends.all()
    reports = []
    run._descend(run._learned_from(batch), reports)
    assert reports[0]["kl_approx"].abs() < 1e-6
    assert reports[0]["max_ratio"] == pytest.approx(1.0, abs=1e-5)
    # The same rows without their order are another policy's.
    shuffled = run._learned_from(batch)[:, torch.randperm(STEPS)]
    run._descend(shuffled, reports)
    assert reports[1]["max_ratio"] > 1.01


def test_minibatches_of_a_recurrent_actor_are_sequences_of_whole_cars(file, monkeypatch):
    run, seen = run_of(file, "recurrent", minibatch=3 * STEPS), []
    monkeypatch.setattr(run, "_descend", lambda rows, reports: seen.append(rows.batch_size))
    run._update(run.collector.rollout(), [])
    assert seen == 2 * [(3, STEPS), (3, STEPS), (2, STEPS)]
    with pytest.raises(
        ValueError, match=r"ppo\.minibatch=8 holds no sequence of ppo\.batch_steps=16"
    ):
        run_of(file, "recurrent", minibatch=8)


@pytest.mark.parametrize("kind", ["squashed", *RECURRENT])
def test_its_file_drives_as_it_did_without_exploration(file, kind, tmp_path):
    torch.manual_seed(0)
    policy = Policy(1, PolicyConfig(actor=f"{file}:{kind}"))
    policy.observe(3 * torch.randn(50, 1) + 1)
    save_policy(policy, tmp_path / "policy.pt", {})
    loaded, _ = load_policy(tmp_path / "policy.pt")
    assert loaded.config.actor == f"{file}:{kind}"
    driven = []
    for each in (policy, loaded):
        env = TransformedEnv(Point(), StepCounter(max_steps=LIMIT))
        torch.manual_seed(3)
        rows = env.rollout(2 * LIMIT, each.driver(), break_when_any_done=False)
        driven.append(rows["action"])
    assert torch.equal(*driven)
    assert "scale" not in rows


@pytest.mark.parametrize("kind", RECURRENT)
def test_it_drives_a_new_episode_as_the_first_whatever_was_before(file, kind):
    driver = Policy(1, PolicyConfig(actor=f"{file}:{kind}")).driver()

    def steps(*numbers):
        for number in numbers:
            given = {
                "observation": torch.full((2, 1), 0.3),
                "step_count": torch.full((2, 1), number),
            }
            yield driver(TensorDict(given, [2]))["action"]

    first, second = steps(0, 1)
    again, further = steps(0, 1)
    assert torch.equal(first, again)
    assert torch.equal(second, further)
    assert not torch.equal(first, second)  # it remembers
    stranger = Policy(1, PolicyConfig(actor=f"{file}:{kind}")).driver()
    given = {"observation": torch.zeros(2, 1), "step_count": torch.ones(2, 1)}
    with pytest.raises(ValueError, match="from its first step on"):
        stranger(TensorDict(given, [2]))


def test_a_critic_of_ones_own_is_trained(file):
    torch.manual_seed(0)
    policy = Policy(1, PolicyConfig(critic=f"{file}:value"))
    run = PPO(point(), policy, config())
    before = policy.own_critic.state_dict()["module.weight"].clone()
    list(run.run())
    assert not torch.equal(before, policy.own_critic.state_dict()["module.weight"])


@pytest.mark.parametrize(
    ("setting", "name", "said"),
    [
        ("actor", "mine", "policy.actor=mine: must be file.py:factory"),
        ("actor", "my_actor.py:none", "my_actor.py has no 'none'"),
        ("actor", "my_actor.py:silent", "does not write .*log_prob: give .* return_log_prob=True"),
        (
            "actor",
            "my_actor.py:broken",
            r"broken\(observation_size, config\): .*takes 1 positional",
        ),
        (
            "actor",
            "my_actor.py:other",
            "returned an object of class Linear, expected a Probabilistic",
        ),
        ("actor", "builtins:dict", "the class builtins.dict, expected a subclass of tensordict"),
        ("critic", "my_actor.py:squashed", r"it has to write state_value"),
    ],
)
def test_what_is_no_actor_or_critic_is_refused(file, setting, name, said):
    with pytest.raises(ValueError, match=said):
        Policy(1, PolicyConfig(**{setting: name}))


def test_code_from_elsewhere_is_not_run_when_a_policy_is_loaded(file, tmp_path, monkeypatch):
    save_policy(
        Policy(1, PolicyConfig(actor=str(Path(file).resolve()) + ":squashed")), Path("p.pt"), {}
    )
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match=r"p\.pt names code that lies outside the working folder"):
        load_policy("../p.pt")


def test_the_exporter_and_other_processes_refuse_it(file):
    own = PolicyConfig(actor=f"{file}:squashed")
    save_policy(Policy(1, own), Path("p.pt"), {})
    with pytest.raises(ValueError, match=r"p\.pt has an actor of its own, my_actor\.py:squashed"):
        Export(ExportConfig(policy="p.pt", output="x"))
    run = PolicyRunConfig(output="x", policy=own, collector=CollectorConfig("rpc"))
    with pytest.raises(
        ValueError, match=r"drives in this process only: leave out collector\.backend"
    ):
        new_batches(run, Policy(1, own))


def test_the_question_of_a_training_has_the_content_of_its_actor(file):
    run = PolicyRunConfig(output="x", policy=PolicyConfig(actor=f"{file}:squashed"))
    before = policy_question(run)
    Path(file).write_text(Path(file).read_text() + "\n# changed\n")
    assert policy_question(run) != before
