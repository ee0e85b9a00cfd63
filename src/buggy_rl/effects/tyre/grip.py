"""Another friction than the simulated: of all tyres, front against rear, in one place."""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.vehicle import GRAVITY
from buggy_rl.effects.base import EffectParameter, more_or_less
from buggy_rl.effects.motion.base import Motion
from buggy_rl.effects.tyre.base import TyreEffect

NO_BOUND = 1000.0  # [m/s^2] neutral bound: 100 g, beyond any tyre
EDGE = 0.05  # [m] scale of the sigmoid at the edge: 12 to 88 % over 0.2 m; chosen
PACEJKA = "Pacejka 2012, Tire and Vehicle Dynamics, 3rd ed."


class TireGrip(TyreEffect):
    """Another friction of both axles; or a bound on the lateral acceleration.

    `max_acceleration` is shared between the axles in proportion to their loads.
    """

    name = "tire_grip"
    look_at = "Look at tyres and floor: wear, dust, another surface, cold tyres."
    equation = "|F_axle| <= grip friction load, at the same stiffness; |ay| <= max_acceleration"
    source = f"{PACEJKA}, sec. 4.2 (similarity method)"
    alternatives = ("max_acceleration",)
    declared = (
        EffectParameter(
            "grip",
            1.0,
            0.1,
            2.5,
            "-",
            "Friction over the simulated.",
            size=0.3,
            probe=-0.03,
            usual=(0.4, 1.4),
        ),
        EffectParameter(
            "max_acceleration",
            NO_BOUND,
            0.5,
            NO_BOUND,
            "m/s^2",
            "Largest lateral acceleration that the tyres give.",
            size=8.0,
            probe=6.0 - NO_BOUND,
            reciprocal=True,
            usual=(3.0, 10.0),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        grip, most = values.get("grip", 1.0), values.get("max_acceleration", NO_BOUND)
        words = []
        if grip != 1.0 or most >= NO_BOUND:
            words.append(f"the tyres hold {more_or_less(grip)} than simulated before they slide")
        if most < NO_BOUND:
            words.append(f"the tyres give at most {most / GRAVITY:.2g} g sideways")
        return ", and ".join(words)

    def _ratios(self, motion: Motion) -> tuple[Tensor, Tensor]:
        grip = self._value("grip").clamp_min(1e-2)
        return grip, grip

    def _most(self, motion: Motion) -> Tensor:
        return self._value("max_acceleration")


class GripBalance(TyreEffect):
    """Friction of the front axle against the rear one; their product stays."""

    name = "grip_balance"
    look_at = "Compare front and rear tyres (compound, wear, dust) and the weight on each axle."
    equation = "front friction sqrt(q), rear friction / sqrt(q), at the same stiffness"
    source = f"{PACEJKA}, sec. 4.2 (similarity method), by axle"
    declared = (
        EffectParameter(
            "front_to_rear",
            1.0,
            0.2,
            5.0,
            "-",
            "Front friction over rear, over simulated.",
            size=0.2,
            probe=0.03,
            usual=(0.7, 1.4),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        ratio = values["front_to_rear"]
        end = "nose pushes outwards" if ratio < 1 else "tail comes round"
        return f"the {end} earlier: front against rear, the tyres hold {more_or_less(ratio)}"

    def _ratios(self, motion: Motion) -> tuple[Tensor, Tensor]:
        front = self._value("front_to_rear").clamp_min(1e-2).sqrt()
        return front, 1 / front


class GripPatch(TyreEffect):
    """Another friction inside a circle on the floor, of each axle by its own place."""

    name = "grip_patch"
    look_at = "Look at the floor at this place: dust, liquid, a mat, another surface."
    equation = "tire_grip within radius of (x, y)"
    source = f"{PACEJKA}, sec. 4.2 (similarity method), by place"
    deciding = ("grip",)
    declared = (
        EffectParameter("x", 0.0, -1000.0, 1000.0, "m", "Centre of the patch, world.", 2.0, 0.1),
        EffectParameter("y", 0.0, -1000.0, 1000.0, "m", "Centre of the patch, world.", 2.0, 0.1),
        EffectParameter(
            "radius", 0.5, 0.05, 100.0, "m", "Of the patch.", 0.5, 0.1, usual=(0.2, 3.0)
        ),
        EffectParameter(
            "grip",
            1.0,
            0.1,
            2.5,
            "-",
            "Friction over the simulated.",
            size=0.4,
            probe=-0.03,
            usual=(0.2, 1.5),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return (
            f"within {values['radius']:.2g} m of ({values['x']:.2f}, {values['y']:.2f}) m the "
            f"tyres hold {more_or_less(values['grip'])} than simulated"
        )

    def _ratios(self, motion: Motion) -> tuple[Tensor, Tensor]:
        d = self.dimensions
        ahead = torch.stack([torch.cos(motion.heading), torch.sin(motion.heading)], -1)
        front, behind = d.cg_to_front_axle - d.sensor_to_cg, d.cg_to_rear_axle + d.sensor_to_cg
        place = motion.pose[..., :2]
        return self._grip_at(place + front * ahead), self._grip_at(place - behind * ahead)

    def _grip_at(self, place: Tensor) -> Tensor:
        """Friction over the simulated one, q [n], of an axle at a place [n, 2] [m]."""
        away = place - torch.stack([self._value("x"), self._value("y")], -1)
        distance = (away.square().sum(-1) + 1e-12).sqrt()
        # Not by `torch.sigmoid`, whose last bit depends on where in the batch a car is.
        inside = 0.5 + 0.5 * torch.tanh(0.5 * (self._value("radius") - distance) / EDGE)
        return 1 + (self._value("grip").clamp_min(1e-2) - 1) * inside
