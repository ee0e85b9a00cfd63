"""PPO's settings."""

from dataclasses import dataclass, field
from typing import Any, Literal

from buggy_rl.core.config import belongs_to


@dataclass(frozen=True)
class PPOConfig:
    """How a policy is trained; `configs/ppo_original.yaml` holds the original study's settings."""

    steps: int = 3_000_000
    """Steps of all environments together."""
    cars: int = 256
    """Environments stepped at once."""
    batch_steps: int = 32
    """Steps of each environment between two updates."""
    epochs: int = 5
    """Passes over a batch in an update."""
    minibatch: int = 2048
    """Most steps in a gradient step; a batch is divided into as few equal parts as that allows."""
    learning_rate: float = 3e-3
    """Adam's, at the start."""
    schedule: Literal["linear", "constant"] = "linear"
    """Schedule of the learning rate: down to nothing over the training, or as it is."""
    discount: float = 0.98
    """Discount of the reward, a step (gamma)."""
    trace: float = 0.95
    """Decay of the advantage estimate, a step (lambda)."""
    loss: str = "clip"
    """clip, kl or a2c: TorchRL's ClipPPOLoss, KLPENPPOLoss, A2CLoss; or one's own as file.py:Class,
    a LossModule that takes actor and critic."""
    loss_options: dict[str, Any] = field(default_factory=dict, metadata=belongs_to("loss"))
    """Further arguments of its class, such as dtarg of kl."""
    clip: float = 0.2
    """Clipping of the likelihood ratio, either way."""
    value_weight: float = 0.5
    """Weight of the critic's loss."""
    entropy_weight: float = 0.0
    """Weight of the entropy bonus; 0 leaves it out."""
    gradient_norm: float = 1.0
    """Longest gradient."""
    stagger: bool = True
    """Starts the first episodes at random ages, so that resets spread over time."""
    seed: int = 0
    """Seed of the order of minibatches."""
    compiled: Literal["auto", "always", "never"] = "auto"
    """Whether PyTorch compiles loss and gradient; auto: where a C++ compiler is at hand and the
    training has a million steps. The numbers are the same to rounding."""

    @property
    def batch(self) -> int:
        """Steps of all environments together between two updates."""
        return self.cars * self.batch_steps
