"""How likely drives are, given what a simulator says of them."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.estimation.rollout import Player, Values
from buggy_rl.estimation.segments import Stretches, sensor_noise, start_noise

Settings = tuple[Values, Mapping[str, Tensor], Tensor]
HEAVY = 4.0  # a stretch this many times worse than expected begins to count for less


@dataclass(frozen=True)
class Likelihood:
    """Gaussian errors of a stretch, correlated by its start, with heavy tails over stretches.

    The readings of a stretch differ from a right simulator's by e = A b + n, with n the sensor's
    noise and b the error of the start, A its effect. So e ~ N(0, C), C = D + A S A^T; W C W^T = I.
    Of a stretch that is far worse than that, such as one in which the car spins, counts

    loss = h/2 log(1 + |W e|^2 / h),  h = HEAVY times the number of readings.
    """

    whitening: Tensor
    """[N, D, D] float64, lower triangular; D = K * 6."""
    noise: Tensor
    """[6] of a reading."""
    extra: Tensor | None = None
    """[D, D] covariance of what the simulator gets wrong where it counts as right."""

    @property
    def readings(self) -> int:
        """Numbers in a stretch (D)."""
        return self.whitening.shape[-1]

    def __getitem__(self, index: Tensor) -> "Likelihood":
        return Likelihood(self.whitening[index], self.noise, self.extra)

    def white(self, gap: Tensor) -> Tensor:
        """W e [C, N, D] of gaps [C, N, K, 6]; what is not finite becomes large."""
        flat = gap.flatten(2).double().nan_to_num(1e3, 1e3, -1e3).clamp(-1e3, 1e3)
        return torch.einsum("nij,cnj->cni", self.whitening, flat)

    def instead_of(self, other: "Likelihood") -> Tensor:
        """[N, D, D] that whitens anew what the other one has whitened: W W_other^-1."""
        return torch.linalg.solve_triangular(other.whitening.mT, self.whitening.mT, upper=True).mT

    def loss(self, square: Tensor, temper: float = 1.0) -> Tensor:
        """Of stretches with |W e|^2 = `square` [*], in nats."""
        heavy = HEAVY * self.readings
        return 0.5 * heavy * torch.log1p(square / temper / heavy)

    def weight(self, square: Tensor, temper: float = 1.0) -> Tensor:
        """Derivative of twice the loss by the square, times the temper."""
        return 1 / (1 + square / temper / (HEAVY * self.readings))


def likelihood(
    player: Player,
    cut: Stretches,
    settings: Settings | None = None,
    extra: Tensor | None = None,
    seen: Stretches | None = None,
) -> Likelihood:
    """Whitening of stretches about a simulator.

    Args:
        player: Plays into the simulator.
        cut: The stretches.
        settings: Effects, parameters and offset of the simulator, as `Player.play` takes them, of
            one set; none by default.
        extra: [D, D] covariance of what the simulator gets wrong where it is right.
        seen: Stretches that tell how noisy the sensor is; None for `cut` itself.
    """
    seen = cut if seen is None else seen
    noise = sensor_noise(seen)
    shift = torch.cat([torch.zeros(1, 6), torch.diag(start_noise(seen))])
    effects, parameters, offset = settings or ({}, {}, torch.zeros(1))
    many = {e: {p: v.expand(7) for p, v in ps.items()} for e, ps in effects.items()}
    own = {name: v.expand(7) for name, v in parameters.items()}
    gap = player.play(cut, many, own, offset.expand(7), shift).double()  # (7, N, K, 6)
    slopes = (gap[1:] - gap[:1]).flatten(2).movedim(0, -1)  # (N, D, 6)
    slopes = slopes.nan_to_num(0.0).clamp(-10, 10)
    readings = gap.shape[2]
    diagonal = torch.diag(noise.double().square().repeat(readings))
    covariance = diagonal + slopes @ slopes.mT
    if extra is not None:
        covariance = covariance + extra
    factor = torch.linalg.cholesky(covariance)
    eye = torch.eye(covariance.shape[-1], dtype=torch.float64).expand_as(covariance)
    return Likelihood(torch.linalg.solve_triangular(factor, eye, upper=False), noise, extra)
