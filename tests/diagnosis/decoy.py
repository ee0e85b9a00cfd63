"""A candidate that means nothing: accelerations at random, free in three numbers."""

import torch

from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import MotionEffect

SEED, FEATURES = 7, 12


def number(name):
    return EffectParameter(name, 0.0, -50.0, 50.0, "m/s^2", "Of nothing.", 1.0, 0.1)


class Decoy(MotionEffect):
    """dv/dt = a tanh(W s + b), a in three numbers, s the velocity and the commands."""

    name = "decoy"
    equation = "dv/dt = a tanh(W s + b)"
    declared = (number("a"), number("b"), number("c"))

    @classmethod
    def sentence(cls, values):
        return "the car does as dice fall"

    def _change(self, motion):
        generator = torch.Generator().manual_seed(SEED)
        weight = torch.randn(5, FEATURES, generator=generator)
        mix = torch.randn(FEATURES, 3, 3, generator=generator) / FEATURES**0.5
        seen = torch.cat([motion.after, motion.action], -1)
        features = torch.tanh(seen @ weight)
        size = torch.stack([self._value(p.name).expand(len(seen)) for p in self.declared], -1)
        return self.dt * torch.einsum("nf,fij,ni->nj", features, mix, size)
