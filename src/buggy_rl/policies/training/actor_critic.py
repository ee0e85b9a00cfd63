"""The policy: a Gaussian actor and its critic, from a config, to a file and back."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

import torch
from tensordict import TensorDictBase
from tensordict.nn import (
    ProbabilisticTensorDictSequential,
    TensorDictModule,
    TensorDictModuleBase,
)
from torch import Tensor, nn
from torch.distributions import Distribution
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator

from buggy_rl.core import keys, trust
from buggy_rl.core.files import load_torch, save_torch
from buggy_rl.policies.training.own_actor import OwnDriver, make_actor, make_critic

ACTIONS = 2  # throttle, steering
ACTIVATIONS = {"relu": nn.ReLU, "tanh": nn.Tanh, "elu": nn.ELU}
SMALL_GAIN = 0.01  # of the actor's last layer: at first every command is near zero
OBSERVATION_LIMIT = 5.0  # standard deviations, beyond which an observation is cut off
SMALLEST_SD = 1e-2  # of an observation, in its own unit: a number that hardly moves stays small


@dataclass(frozen=True)
class PolicyConfig:
    """Layers, exploration and scaling of actor and critic."""

    hidden: list[int] = field(default_factory=lambda: [64, 64])
    """Widths of the hidden layers, of the actor as of the critic."""
    activation: Literal["relu", "tanh", "elu"] = "relu"
    """Activation between the layers."""
    initial_sd: float = 0.3
    """Standard deviation of either command when training begins; learned, one in all states."""
    scaling: Literal["running", "none"] = "running"
    """`running` takes observations by their mean and sd over training; `none` as they are."""
    actor: str = ""
    """An actor of one's own, file.py:factory or package.module:factory, which is given observation
    size and this config and returns TorchRL's ProbabilisticActor; empty for the package's."""
    critic: str = ""
    """A critic of one's own likewise, a TensorDictModule that writes state_value."""


class Scaling(nn.Module):
    """(x - mean) / sd with the mean and sd [size] of all observations seen so far.

    They are part of the weights, so that a policy file is complete, and change only between two
    batches: within one, collection and update use the same numbers.
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.count = nn.Buffer(torch.zeros((), dtype=torch.float64))
        self.mean = nn.Buffer(torch.zeros(size))
        self.sd = nn.Buffer(torch.ones(size))

    def forward(self, observation: Tensor) -> Tensor:
        scaled = (observation - self.mean) / self.sd
        return scaled.clamp(-OBSERVATION_LIMIT, OBSERVATION_LIMIT)

    @torch.no_grad()
    def update(self, observation: Tensor) -> None:
        """Includes further observations [*, size], by the parallel form of Welford's sums.

        Source: Chan, Golub, LeVeque, Updating formulae and a pairwise algorithm, 1979.
        """
        rows = observation.reshape(-1, observation.shape[-1]).double()
        total = self.count + len(rows)
        gap = rows.mean(0) - self.mean
        seen = self.count * self.sd.double().square() * (self.count > 0)
        squares = seen + len(rows) * rows.var(0, correction=0)
        squares = squares + gap.square() * self.count * len(rows) / total
        self.mean.add_((gap * len(rows) / total).float())
        self.sd.copy_((squares / total).sqrt().clamp_min(SMALLEST_SD))
        self.count.copy_(total)


class Gaussian(Distribution):
    """Independent normal commands: log p(u) = -sum_i (z_i^2 / 2 + log sd_i + log(2 pi) / 2).

    z = (u - mean) / sd.

    Args:
        loc: Means [*, n].
        log_sd: Logarithms [n] of the standard deviations, the same in every state.
    """

    has_rsample = True
    arg_constraints: ClassVar[dict[str, Any]] = {}  # pyrefly: ignore[bad-override]

    def __init__(self, loc: Tensor, log_sd: Tensor) -> None:
        self.loc, self.log_sd = loc, log_sd
        self.scale = log_sd.exp()
        super().__init__(loc.shape[:-1], loc.shape[-1:], validate_args=False)

    def rsample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        noise = torch.randn((*sample_shape, *self.loc.shape), device=self.loc.device)
        return torch.addcmul(self.loc, noise, self.scale)

    @torch.no_grad()
    def sample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        return self.rsample(sample_shape)

    def log_prob(self, value: Tensor) -> Tensor:
        z = (value - self.loc) / self.scale
        return -0.5 * z.square().sum(-1) - self._constant()

    def entropy(self) -> Tensor:
        return (self._constant() + 0.5 * self.log_sd.numel()).expand(self.batch_shape)

    def _constant(self) -> Tensor:
        return self.log_sd.sum() + 0.5 * math.log(2 * math.pi) * self.log_sd.numel()


class Actor(TensorDictModuleBase):
    """Draws commands; with TorchRL's exploration set to deterministic, the mean.

    Where gradients are on, a command passes them to mean and deviation (reparametrised).

    Equal to TorchRL's `ProbabilisticActor` with `IndependentNormal`, at a fraction of its fixed
    cost a call, which matters at some hundred environments and minibatches of 2048 rows.

    Args:
        mean: Observations [*, size] to mean commands [*, n].
        log_sd: [n]
    """

    def __init__(self, mean: nn.Module, log_sd: nn.Parameter) -> None:
        super().__init__()
        self.in_keys = [keys.OBSERVATION]
        self.out_keys = ["loc", "scale", keys.ACTION, "action_log_prob"]
        self.mean, self.log_sd = mean, log_sd

    def get_dist(self, tensordict: TensorDictBase) -> Gaussian:
        """The distribution of commands for `observation` [*, size]; TorchRL's losses ask for it."""
        return self.distribution(tensordict.get(keys.OBSERVATION))

    def distribution(self, observation: Tensor) -> Gaussian:
        """The distribution of commands for observations [*, size]."""
        return Gaussian(self.mean(observation), self.log_sd)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action`, `loc`, `scale` [*, n] and `action_log_prob` [*]."""
        drawn = self.get_dist(tensordict)
        mean_wanted = exploration_type() == ExplorationType.DETERMINISTIC
        action = drawn.loc if mean_wanted else drawn.rsample()
        tensordict.set("loc", drawn.loc)
        tensordict.set("scale", drawn.scale.expand_as(drawn.loc))
        tensordict.set(keys.ACTION, action)
        return tensordict.set("action_log_prob", drawn.log_prob(action))


class _Spread(nn.Module):
    """Observations [*, size] to means and standard deviations [*, n]."""

    def __init__(self, mean: nn.Module, log_sd: nn.Parameter) -> None:
        super().__init__()
        self.mean, self.log_sd = mean, log_sd

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        loc = self.mean(observation)
        return loc, self.log_sd.exp().expand_as(loc)


class Policy(nn.Module):
    """An actor, a critic, and the deterministic actor (`driver`) for evaluation.

    Commands of the package's actor are not squashed: the simulator clamps them and the data keep
    the sample, because the density of a squashed command diverges at its limits.
    """

    def __init__(self, observation_size: int, config: PolicyConfig | None = None) -> None:
        super().__init__()
        self.config = config or PolicyConfig()
        self.observation_size = observation_size
        self.scaling = (
            Scaling(observation_size) if self.config.scaling == "running" else nn.Identity()
        )
        if self.config.actor:
            self.own_actor = make_actor(self.config.actor, observation_size, self.config)
        else:
            self.mean_layers = _layers(observation_size, ACTIONS, SMALL_GAIN, self.config)
        if self.config.critic:
            self.own_critic = make_critic(self.config.critic, observation_size, self.config)
        else:
            self.value_layers = _layers(observation_size, 1, 1.0, self.config)
        if not self.config.actor:
            initial = math.log(self.config.initial_sd)
            self.log_sd = nn.Parameter(torch.full((ACTIONS,), initial))

    def actor(self) -> Actor | ProbabilisticTensorDictSequential:
        """Draws `action` [*, 2] for `observation` [*, size], with `action_log_prob` [*]."""
        if self.config.actor:
            return self.own_actor
        return Actor(nn.Sequential(self.scaling, self.mean_layers), self.log_sd)

    def torchrl_actor(self) -> ProbabilisticTensorDictSequential:
        """TorchRL's actor with the same weights and distribution, for losses that ask for one."""
        if self.config.actor:
            return self.own_actor
        spread = _Spread(nn.Sequential(self.scaling, self.mean_layers), self.log_sd)
        return ProbabilisticActor(
            TensorDictModule(spread, [keys.OBSERVATION], ["loc", "scale"]),
            in_keys=["loc", "scale"],
            distribution_class=IndependentNormal,
            return_log_prob=True,
        )

    def critic(self) -> TensorDictModuleBase:
        """Writes `state_value` [*, 1] of `observation` [*, size]."""
        if self.config.critic:
            return self.own_critic
        return ValueOperator(nn.Sequential(self.scaling, self.value_layers), [keys.OBSERVATION])

    def driver(self) -> TensorDictModuleBase:
        """Writes the mean `action` [*, 2]; deterministic, for evaluation."""
        if self.config.actor:
            return OwnDriver(self.own_actor)
        mean = nn.Sequential(self.scaling, self.mean_layers)
        return TensorDictModule(mean, [keys.OBSERVATION], [keys.ACTION])

    @torch.no_grad()
    def observe(self, observation: Tensor) -> None:
        """Includes observations [*, size] in every `Scaling`, also in those of one's own actor."""
        for part in self.modules():
            if isinstance(part, Scaling):
                part.update(observation)

    @torch.no_grad()
    def exploration(self, batch: TensorDictBase) -> dict[str, float]:
        """`sd_throttle` and `sd_steering`; of one's own actor the mean of its `scale`, if any."""
        if not self.config.actor:
            scale = self.log_sd.exp()
        elif "scale" in batch:
            scale = batch.get("scale").reshape(-1, ACTIONS).mean(0)
        else:
            return {}
        return dict(zip(("sd_throttle", "sd_steering"), scale.tolist(), strict=True))


def _layers(size: int, out: int, gain: float, config: PolicyConfig) -> nn.Sequential:
    """Fully connected, with orthogonal weights that keep the spread of what goes through."""
    layers: list[nn.Module] = []
    for width in config.hidden:
        layers += [_orthogonal(nn.Linear(size, width), math.sqrt(2))]
        layers += [ACTIVATIONS[config.activation]()]
        size = width
    return nn.Sequential(*layers, _orthogonal(nn.Linear(size, out), gain))


def _orthogonal(layer: nn.Linear, gain: float) -> nn.Linear:
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def save_policy(policy: Policy, file: Path, about: dict[str, Any]) -> None:
    """Writes weights, scaling and config, atomically, with what the policy was trained on."""
    content = {
        "policy": asdict(policy.config),
        "observation_size": policy.observation_size,
        "weights": policy.state_dict(),
        "about": about,
    }
    save_torch(file, content)


def load_policy(file: Path | str) -> tuple[Policy, dict[str, Any]]:
    """Reads a policy, without gradients, and the record of its training.

    Raises:
        ValueError: There is no such file, it is not a policy's, or it names code that is not to be
            run (`trust`).
    """
    if not Path(file).is_file():
        raise ValueError(f"there is no policy file {file}: train one with scripts/train_policy.py")
    content = load_torch(file)
    needed = {"policy", "observation_size", "weights", "about"}
    if not isinstance(content, dict) or not needed <= set(content):
        raise ValueError(f"{file} was not written by scripts/train_policy.py")
    config = PolicyConfig(**content["policy"])
    for name in (config.actor, config.critic):
        trust.refuse_foreign(name, file)
    policy = Policy(content["observation_size"], config)
    policy.load_state_dict(content["weights"])
    return policy.eval().requires_grad_(False), content["about"]
