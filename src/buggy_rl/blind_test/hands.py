"""Drivers with other hands than the room driver's: one that dares little, one that dares all."""

from torch import Tensor

from buggy_rl.policies.controllers.room import RoomDriver

TIMID_DRIVE, TIMID_STEERING = 0.5, 0.65  # [-] shares of what the room driver commands


class TimidDriver(RoomDriver):
    """Half the throttle, two thirds of the steering."""

    def _drive(self, speed: Tensor) -> Tensor:
        return TIMID_DRIVE * super()._drive(speed)

    def _steering(self) -> Tensor:
        return TIMID_STEERING * super()._steering()


class WildDriver(RoomDriver):
    """Eases the throttle neither in bends nor in slides: its car spins now and then."""

    def _kept_straight(self, velocity: Tensor, drive: Tensor, steering: Tensor) -> Tensor:
        return drive
