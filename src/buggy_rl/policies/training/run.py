"""A run of policy training: simulator, task, policy, validation and checkpoint."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import torch
from omegaconf import MISSING
from torchrl.envs import EnvBase, TransformedEnv

from buggy_rl.core import keys, trust
from buggy_rl.core.config import belongs_to, from_plain, plain_values, save_run
from buggy_rl.core.files import save_torch
from buggy_rl.core.question import Question, question, refuse_another, schema
from buggy_rl.policies.closed_loop import drive
from buggy_rl.policies.training.actor_critic import (
    Policy,
    PolicyConfig,
    load_policy,
    save_policy,
)
from buggy_rl.policies.training.checkpoint import load_checkpoint
from buggy_rl.policies.training.collecting import (
    CollectorConfig,
    DistributedBatches,
    PartMaker,
    make_collector,
)
from buggy_rl.policies.training.ppo import PPO
from buggy_rl.policies.training.ppo_config import PPOConfig
from buggy_rl.policies.training.shac import SHAC, SHACConfig
from buggy_rl.policies.training.trainer import NonFiniteLossError, Trainer, TrainerSettings
from buggy_rl.task.config import TaskConfig, evaluation_transforms
from buggy_rl.task.env import make_env, make_simulator
from buggy_rl.task.paths.making import Part, make_paths
from buggy_rl.task.paths.path_set import joined_paths

VALIDATED: tuple[Part, ...] = ("selection", "validation")
"""Paths of a validation: those that the best policy is chosen by, and those that tell how good it
is; a best of several on the latter would be told too good."""
CLOCKED = ("speed", "seconds_left")
"""Metrics that depend on the machine: left out of policy files, which are those of the training."""
SCHEMA = 2  # of checkpoints: raised when other code would not go on from them
# Of the config: these change no policy.
IGNORED = (
    *("output", "threads", "resume", "wandb", "media", "collector", "ppo.compiled"),
    "checkpoint_batches",
)
ALGORITHMS: dict[str, Callable[..., Trainer]] = {"ppo": PPO, "shac": SHAC}
"""Made of environment, policy, the settings of that name in the config, and batches from elsewhere;
a further one is a line here, its name at `algorithm`, and its settings beside `ppo`."""
LATER = {
    "algorithm": "ppo",
    "start": "",
    **{"ppo.loss": "clip", "ppo.loss_options": "{}", "policy.actor": "", "policy.critic": ""},
}
"""Settings that earlier checkpoints do not name, and what they meant without them."""


@dataclass(frozen=True)
class EngineConfig:
    """The simulator; two runs that compare simulators differ in nothing else."""

    simulator: str = "mujoco"
    """An engine's name, a .yaml, a .pt, or file.py:factory."""
    parameters: dict[str, float] = field(default_factory=dict, metadata=belongs_to("simulator"))
    """Physical parameters that differ from the engine's own."""
    options: dict[str, Any] = field(default_factory=dict, metadata=belongs_to("simulator"))
    """Further arguments of the engine's class."""


@dataclass(frozen=True)
class PolicyRunConfig:
    """Everything from a simulator to a policy that drives it."""

    output: str = MISSING
    """Folder for the policy, checkpoints and logs."""
    engine: EngineConfig = field(default_factory=EngineConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    policy: PolicyConfig = field(default_factory=PolicyConfig)
    algorithm: Literal["ppo", "shac"] = "ppo"
    """What trains the policy, by the settings of that name: ppo in any simulator, shac by gradients
    through one that passes them."""
    ppo: PPOConfig = field(default_factory=PPOConfig)
    shac: SHACConfig = field(default_factory=SHACConfig)
    collector: CollectorConfig = field(default_factory=CollectorConfig)
    validations: int = 6
    """Validations during training, evenly spaced; the best on the selection paths is kept."""
    validation_steps: int = 1000
    """Steps of an episode in validation."""
    checkpoint_batches: int = 10
    """Batches between two checkpoints."""
    start: str = ""
    """Policy file whose layers and weights the training begins with, such as one that was trained
    before the simulator was repaired; empty for new ones by `policy`."""
    seed: int = 0
    """Fixes starts, exploration and weights; ppo.seed the order of minibatches."""
    threads: int = 1
    """Threads of PyTorch."""
    resume: bool = False
    """Goes on from the last checkpoint in OUTPUT as if never stopped."""
    wandb: bool = False
    """Logs to Weights & Biases too, offline unless WANDB_MODE says otherwise."""
    media: bool = False
    """Draws and films the policy after each validation, in OUTPUT/media and in the logs."""

    @property
    def settings(self) -> TrainerSettings:
        """The settings of the algorithm."""
        return getattr(self, self.algorithm)


def training_engine(about: dict[str, Any], file: Path | str) -> EngineConfig:
    """The simulator that a policy was trained in, by its file's record.

    Raises:
        ValueError: It is none of this version, or code that is not to be run (`trust`).
    """
    config = from_plain(EngineConfig, about["config"]["engine"], str(file))
    for simulator in (config.simulator, config.options.get("simulator", "")):  # of a surrogate
        trust.refuse_foreign(str(simulator), file)
    return config


def task_of(about: dict[str, Any], file: Path | str) -> TaskConfig:
    """The task that a policy was trained for, by its file's record.

    Raises:
        ValueError: It is none of this version, or names code that is not to be run (`trust`).
    """
    config = from_plain(TaskConfig, about["config"]["task"], str(file))
    for transform in config.transforms.values():
        trust.refuse_foreign(transform.name, file)
    return config


def policy_question(config: PolicyRunConfig) -> Question:
    """What the policy of a training depends on."""
    others = [name for name in ALGORITHMS if name != config.algorithm]
    asked = question(config, ignoring=(*IGNORED, *others))
    return {name: value for name, value in asked.items() if LATER.get(name) != value}


def _so_far(asked: Question) -> Question:
    """What must be the same to go on from a checkpoint.

    A training may be made longer, and go on on another device.
    """
    free = {"validations", "engine.options.device", *(f"{name}.steps" for name in ALGORITHMS)}
    return {n: v for n, v in asked.items() if n not in free and (n, v) != ("engine.options", "{}")}


def validation_environment(config: PolicyRunConfig) -> TransformedEnv:
    """One environment on each selection path, then one on each validation path.

    None of them is a training path.
    """
    task = validation_task(config.task)
    paths = joined_paths([make_paths(replace(task.paths, part=part)) for part in VALIDATED])
    return make_env(new_engine(config.engine, len(paths)), task=task, paths=paths)


def validation_task(task: TaskConfig) -> TaskConfig:
    """The same task on the validation paths, environment i on path i."""
    paths = replace(task.paths, part="validation")
    return replace(task, paths=paths, transforms=evaluation_transforms(task.transforms))


def new_policy(env: TransformedEnv, config: PolicyConfig) -> Policy:
    """A policy for an environment's observation."""
    return Policy(env.observation_spec[keys.OBSERVATION].shape[-1], config)


def started(env: TransformedEnv, file: str) -> Policy | None:
    """The policy of a file, to be trained on; None without a file.

    Raises:
        ValueError: It takes another observation.
    """
    if not file:
        return None
    policy, _ = load_policy(file)
    size = env.observation_spec[keys.OBSERVATION].shape[-1]
    if policy.observation_size != size:
        raise ValueError(
            f"start={file} takes observations of {policy.observation_size} numbers, the task has "
            f"{size}: train for the task that it was trained for"
        )
    return policy.train().requires_grad_(True)


def validate(env: TransformedEnv, policy: Policy, steps: int) -> dict[str, float]:
    """Means over the validation paths, and `selection_waypoints`.

    Without exploration and without touching random states.

    Args:
        env: From `validation_environment`.
        policy: To be driven.
        steps: Of an episode.
    """
    with torch.random.fork_rng():
        torch.manual_seed(0)
        scores = drive(env, policy.driver(), steps)
    selection, validation = scores.chunk(len(VALIDATED))
    means = {f"validation_{name}": value for name, value in validation.means().items()}
    return {**means, "selection_waypoints": selection.waypoints.mean().item()}


def new_engine(config: EngineConfig, cars: int) -> EnvBase:
    """A simulator with batch size [cars]."""
    return make_simulator(config.simulator, cars, parameters=config.parameters, **config.options)


def new_batches(config: PolicyRunConfig, policy: Policy) -> DistributedBatches | None:
    """Starts the processes that step the environments; None where this one does.

    Raises:
        ValueError: The environments cannot be divided among the processes, or the actor is of one's
            own, which is not sent to them.
    """
    count, cars = config.collector.processes, config.ppo.cars
    if config.collector.backend == "in_process":
        return None
    if config.policy.actor:
        raise ValueError(
            f"policy.actor={config.policy.actor} drives in this process only: leave out "
            f"collector.backend={config.collector.backend}"
        )
    if count < 1 or cars % count:
        raise ValueError(
            f"collector.processes={count} must divide ppo.cars={cars}: each steps as many"
        )
    engine = (config.engine.simulator, config.engine.parameters, config.engine.options)
    own = (cars // count, config.ppo.stagger, config.seed)
    makers = [PartMaker(*engine, config.task, *own, number) for number in range(count)]
    return make_collector(config.collector, makers, policy.actor(), cars * config.ppo.batch_steps)


class PolicyRun:
    """A training run with its validations, its policies and its checkpoint, all in one folder.

    Raises:
        ValueError: There is no checkpoint to go on from, or it is another run's; the message names
            how they differ.
    """

    def __init__(self, config: PolicyRunConfig) -> None:
        self.config, self.folder = config, Path(config.output)
        self._asked = {**policy_question(config), "schema": schema(SCHEMA)}
        self.note = ""
        state = self._kept() if config.resume else None
        self.folder.mkdir(parents=True, exist_ok=True)
        torch.manual_seed(config.seed)
        env = make_env(new_engine(config.engine, config.settings.cars), task=config.task)
        self.validation = validation_environment(config)
        self.policy = started(env, config.start) or new_policy(env, config.policy)
        self._batches = new_batches(config, self.policy)
        make = ALGORITHMS[config.algorithm]
        self.trainer = make(env, self.policy, config.settings, self._batches)
        self.batch = config.settings.batch
        self.best = -1.0  # waypoints on the selection paths
        self._saved = False
        if state is not None:
            self.best = state.pop("best")
            self.trainer.load_state_dict(state)

    def _kept(self) -> dict[str, Any]:
        """The state in the checkpoint, which must be of the same question."""
        file = self.folder / "checkpoint.pt"
        state = load_checkpoint(file)
        remedy = "resume with the settings of the first run, or start without resume=true"
        kept = state.pop("question", None)
        refuse_another(kept and _so_far(kept), _so_far(self._asked), str(file), remedy)
        name, settings = f"{self.config.algorithm}.steps", self.config.settings
        was, now = kept[name], settings.steps
        if was != now and getattr(settings, "schedule", "") == "linear":
            self.note = (
                f"note: begun with {name}={was}, now {now}: so far the learning rate fell as "
                f"for {was} steps, so this is not the policy of one training of {now}"
            )
        return state

    def close(self) -> None:
        """Ends the processes that step environments, if there are any."""
        if self._batches is not None:
            self._batches.close()

    def metrics(self) -> Iterator[dict[str, float]]:
        """Trains batch by batch; writes last.pt and best.pt after each validation.

        The config is written with the first of them.

        Yields:
            What the trainer's `run` does, after a validation also what `validate` tells.

        Raises:
            NonFiniteLossError: A loss is not finite; the batch is in failed_batch.pt.
        """
        try:
            for metrics in self.trainer.run():
                if self._validation_is_due():
                    metrics |= validate(self.validation, self.policy, self.config.validation_steps)
                    self._save_policies(metrics)
                yield metrics
        except NonFiniteLossError as error:
            save_torch(self.folder / "failed_batch.pt", error.batch.to_dict())
            raise

    @property
    def finished(self) -> bool:
        """Whether all steps are done."""
        return self.trainer.steps >= self.config.settings.steps

    @property
    def checkpoint_is_due(self) -> bool:
        """Whether it is time to write the log out and call `checkpoint`."""
        batches = self.trainer.steps // self.batch
        return self.finished or batches % self.config.checkpoint_batches == 0

    def checkpoint(self) -> None:
        """Writes checkpoint.pt, from which a resumed run goes on bit for bit."""
        state = {**self.trainer.state_dict(), "best": self.best, "question": self._asked}
        save_torch(self.folder / "checkpoint.pt", state)

    def _validation_is_due(self) -> bool:
        share = self.config.validations / self.config.settings.steps
        before = self.trainer.steps - self.batch
        return self.finished or int(self.trainer.steps * share) > int(before * share)

    def _save_policies(self, metrics: dict[str, float]) -> None:
        told = {name: value for name, value in metrics.items() if name not in CLOCKED}
        about = {"config": plain_values(self.config), **told}
        if metrics["selection_waypoints"] > self.best:
            self.best = metrics["selection_waypoints"]
            save_policy(self.policy, self.folder / "best.pt", about)
        save_policy(self.policy, self.folder / "last.pt", about)
        if not self._saved:  # with the first policies of this run: until then those of another lie
            save_run(self.config, self.folder)
            self._saved = True
