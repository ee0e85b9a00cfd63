"""Changes the tyre friction of a black-box simulator; the package docstring has the algorithm."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from buggy_rl.core.longitudinal import ONE_WAY_REST
from buggy_rl.effects.motion.base import LOCK, Motion, MotionEffect
from buggy_rl.effects.motion.drive import SPEED_LOSS
from buggy_rl.effects.tyre.change import FrictionChange, changed_by, driven_axles

FRICTION = 0.84  # [-] D: DART, 0.84 front and 0.85 rear
STIFFNESS = (6.1, 9.4)  # [1/rad] C, front and rear: B C D of DART's axles
SHAPE = 1.2  # [-] c, between the slow bend of c = 1 and a brush tyre's 1.4; chosen


class TyreEffect(MotionEffect):
    """Axle forces with another friction; see the package docstring.

    Options that hold for front and rear axle may be given as one number for both.

    Raises:
        ValueError: Friction, stiffness or shape is not above 0, or a share not within 0..1.
    """

    option_names = (
        "friction",
        "stiffness",
        "shape",
        "speed_loss",
        "resistance",
        "height",
        "front_drive_share",
        "combined_slip",
        "lock",
    )
    changes: ClassVar[type[FrictionChange]] = FrictionChange
    """What computes the change."""
    friction: tuple[float, float] = (FRICTION, FRICTION)
    """D of the simulator's front and rear axle."""
    stiffness: tuple[float, float] = STIFFNESS
    """C of its axles [1/rad]."""
    shape: tuple[float, float] = (SHAPE, SHAPE)
    """c of its axles."""
    speed_loss: tuple[float, float] = SPEED_LOSS
    """b0 and b1 [1/s] of its motor, whose acceleration falls by b0 + b1 drive per speed."""
    resistance: tuple[float, float] = (0.0, 0.0)
    """r0 [m/s^2] and r1 [1/s]; 0: all of the resistance is inside motor and gear."""
    height: float = 0.0
    """h [m]; 0: no load transfer."""
    front_drive_share: float = 0.0
    """Share of the drive at the front axle, 0..1; the buggy is driven at the rear."""
    combined_slip: float = 1.0
    """1: the drive takes from the side force by the friction ellipse; 0: it takes nothing."""
    lock: float = LOCK
    """Largest road-wheel angle [rad]."""

    def __init__(self, **rest: Any) -> None:
        super().__init__(**rest)
        share = self.front_drive_share
        self._axles = driven_axles(share)
        self.state_size = self._axles[1] - self._axles[0]
        d = self.dimensions
        pairs = (self.friction, self.stiffness, self.shape, self.speed_loss, self.resistance)
        car = (d.cg_to_front_axle, d.cg_to_rear_axle, d.mass, d.yaw_inertia)
        numbers = [*car, *(number for pair in pairs for number in pair)]
        numbers += [self.height, share, self.combined_slip, self.lock, self.dt]
        self.register_buffer("numbers", torch.tensor(numbers), persistent=False)

    def _option(self, name: str, value: Any) -> Any:
        if name in ("friction", "stiffness", "shape"):
            axles = value if isinstance(value, Sequence) else (value, value)
            if not min(axles) > 0:
                raise ValueError(f"effect {self.name!r}: {name} is {value}: must be above 0")
            value = axles
        if name == "front_drive_share" and not 0.0 <= value <= 1.0:
            raise ValueError(
                f"effect {self.name!r}: front_drive_share is {value}: must be within 0 (rear-wheel "
                "drive) and 1 (front-wheel drive)"
            )
        return super()._option(name, value)

    @abstractmethod
    def _ratios(self, motion: Motion) -> tuple[Tensor, ...]:
        """Friction over the simulated one, q [n], of front and rear axle; or what `changes` takes.

        Each may be of shape ().
        """

    def _most(self, motion: Motion) -> Tensor:
        """Largest lateral acceleration that the tyres give, [n] or () [m/s^2]."""
        return motion.after.new_tensor(torch.inf)

    def _change(self, motion: Motion) -> Tensor:
        return self._change_and_state(motion)[0]

    def _change_and_state(self, motion: Motion) -> tuple[Tensor, Tensor]:
        assert motion.state is not None
        shape = motion.turn_rate.shape
        seen = (motion.before, motion.after, motion.action, motion.state)
        rows = [part.reshape(-1, part.shape[-1]) for part in seen]
        ratio = torch.stack([r.expand(shape).reshape(-1) for r in self._ratios(motion)])
        most = self._most(motion).expand(shape).reshape(-1)
        kernel = changed_by(self._axles, self.rest != ONE_WAY_REST, self.changes)
        friction_change = kernel.fastest(most)
        change, spin = friction_change(self._tensor("numbers"), *rows, ratio, most)
        return change.reshape(*shape, 3), spin.reshape(*shape, self.state_size)
