"""How far a simulator's rollouts are from drives, as a function of its parameters."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from buggy_rl import keys
from buggy_rl.estimation.segments import WARM_UP
from buggy_rl.identification.open_loop import open_loop
from buggy_rl.parameters import Parameter
from buggy_rl.recordings.windows import relative_pose

CHANNEL_SCALE = {  # the error in a channel that weighs as one
    "position": 0.02,  # [m]
    "yaw": 0.03,  # [rad]
    "vx": 0.1,  # [m/s]
    "vy": 0.1,  # [m/s]
    "yaw_rate": 0.3,  # [rad/s]
}
PRIOR_SD = 0.5  # of a parameter's range: keeps what the drives do not show where it was
STEP = 2e-3  # of a parameter's range: finite difference


@runtime_checkable
class Simulator(Protocol):
    """What can be fitted: a simulator that declares parameters (contract of `Engine`)."""

    declared: dict[str, Parameter]

    def with_parameters(self, values: TensorDictBase) -> EnvBase: ...


class RolloutResiduals:
    """Residuals of rollouts and their Jacobian, where each parameter's range is [0, 1].

    The error at an instant is that of position (seen from the start), yaw and velocity, in units
    of `CHANNEL_SCALE`; the parameters' prior adds one residual each.

    Args:
        simulator: What is fitted.
        names: Its parameters to fit.
        windows: [N, WARM_UP + H + 1] of drives.
        smooth_velocity: [N, WARM_UP + H + 1, 3] their velocities without noise and lag.
        every: Rows between the compared instants.

    Raises:
        KeyError: A name is not a parameter of the simulator.
    """

    def __init__(
        self,
        simulator: Simulator,
        names: Sequence[str],
        windows: TensorDictBase,
        smooth_velocity: torch.Tensor,
        every: int,
    ) -> None:
        unknown = sorted(set(names) - set(simulator.declared))
        if unknown:
            raise KeyError(
                f"the simulator has no parameter {', '.join(unknown)}; "
                f"available: {', '.join(sorted(simulator.declared)) or 'none'}"
            )
        self.simulator, self.windows = simulator, windows
        self.start_velocity = smooth_velocity[:, : WARM_UP + 1]
        self.velocity_noise = torch.std(windows[keys.VELOCITY] - smooth_velocity, (0, 1))  # (3,)
        self.whitening: np.ndarray | None = None  # (N, K, K), once starts are free
        self.chosen = [simulator.declared[name] for name in names]
        self.lower = np.array([p.lower for p in self.chosen])
        self.width = np.array([p.upper - p.lower for p in self.chosen])
        values = np.array([p.value for p in self.chosen])
        self.prior = (values - self.lower) / self.width
        steps = windows.batch_size[1] - WARM_UP
        self.instants = torch.arange(every, steps, every)
        if len(self.instants) == 0:
            raise ValueError(
                f"windows of {steps - 1} rows hold no instant to compare every {every} rows: "
                "lengthen fit.horizon or lower fit.every"
            )
        self.measured = self._seen(windows[:, WARM_UP:])

    def value(self, place: np.ndarray) -> np.ndarray:
        """Errors [M] of all windows and instants, then the prior's."""
        return np.concatenate([self._errors(place[None])[0], (place - self.prior) / PRIOR_SD])

    def jacobian(self, place: np.ndarray) -> np.ndarray:
        """Finite differences [M, P], inward at a bound; all columns in one batch."""
        steps = np.where(place < 0.5, STEP, -STEP)
        errors = self._errors(np.stack([place, *(place + np.diag(steps))]))  # (1 + P, M)
        columns = ((errors[1:] - errors[0]) / steps[:, None]).T
        return np.concatenate([columns, np.eye(len(place)) / PRIOR_SD])

    def covariance(self, place: np.ndarray, groups: np.ndarray) -> np.ndarray:
        """Covariance [P, P] of the solution by leaving out one group of windows at a time.

        To first order the solution without group g lies at d_g = (H - H_g)^-1 s_g from the one
        with it, s_g and H_g being the group's score and its part of the Hessian H; the covariance
        is (G - 1) / G sum_g d_g d_g^T. Unlike a sandwich it stays honest when a few groups, such
        as the only ones with full throttle, decide.

        Args:
            place: The solution [P].
            groups: [N] int, windows with the same number are left out together.
        """
        count, width = len(groups), len(place)
        residual, jacobian = self.value(place), self.jacobian(place)
        weight = 1 / np.sqrt(1 + residual**2)  # derivative of soft_l1
        hessian = jacobian.T @ (weight[:, None] * jacobian)
        scores = (jacobian * (weight * residual)[:, None])[:-width].reshape(count, -1, width)
        roots = (jacobian * np.sqrt(weight)[:, None])[:-width].reshape(count, -1, width)
        # What the prior alone holds must not look certain: its curvature counts as noise too.
        inverse = np.linalg.inv(hessian)
        covariance = inverse @ inverse / PRIOR_SD**2
        names = np.unique(groups)
        for name in names:
            inside = roots[groups == name].reshape(-1, width)
            score = scores[groups == name].sum((0, 1))
            shift = np.linalg.solve(hessian - inside.T @ inside, score)  # (P,)
            covariance += (len(names) - 1) / len(names) * np.outer(shift, shift)
        return covariance

    def free_start(self, place: np.ndarray) -> None:
        """From now on rollouts start as measured, each start off by an unknown noise.

        To first order the error of a window is e + A b with b ~ N(0, S) the error of its start and
        A its derivative; b integrated out leaves a residual of covariance C = s^2 I + A S A^T,
        which is whitened here. s is the scatter of the errors at `place`, S the sensor's noise.

        Args:
            place: Parameters [P] at which A and s are taken.
        """
        count = len(self.windows)
        smooth = self._errors(place[None])  # (1, N * K)
        scatter = max(1.4826 * float(np.median(np.abs(smooth))), 1e-3)
        self.start_velocity = self.windows[keys.VELOCITY][:, : WARM_UP + 1]
        noise = torch.clamp(self.velocity_noise, min=1e-4)
        base = self._errors(place[None])
        slopes = []  # of the errors along each start velocity, in its noise
        for channel in range(3):
            shift = torch.zeros(3)
            shift[channel] = noise[channel]
            slopes.append((self._errors(place[None], shift) - base)[0].reshape(count, -1))
        a = np.stack(slopes, -1)  # (N, K, 3), already A sqrt(S)
        covariance = scatter**2 * np.eye(a.shape[1]) + a @ a.transpose(0, 2, 1)
        self.whitening = np.linalg.inv(np.linalg.cholesky(covariance))

    def _errors(self, places: np.ndarray, start_shift: torch.Tensor | None = None) -> np.ndarray:
        """Errors [C, M] of C sets of parameters, in one batch of C * N cars."""
        sets, count = len(places), len(self.windows)
        start = torch.tile(self.start_velocity, (sets, 1, 1))
        if start_shift is not None:
            start[:, -1] += start_shift
        values = torch.as_tensor(self.lower + places * self.width, dtype=torch.float32)  # (C, P)
        batch = TensorDict(
            {
                parameter.name: values[:, column].repeat_interleave(count)
                for column, parameter in enumerate(self.chosen)
            },
            batch_size=[sets * count],
        )
        repeated = self.windows.expand(sets, *self.windows.batch_size).reshape(sets * count, -1)
        made = open_loop(
            lambda _: self.simulator.with_parameters(batch),
            repeated,
            start,
            chunk=sets * count,
        )
        seen = self._seen(made).view(sets, *self.measured.shape)
        errors = (seen - self.measured).flatten(1).double().numpy()  # (C, N * K)
        if self.whitening is not None:
            by_window = errors.reshape(sets, count, -1)
            errors = np.einsum("nij,cnj->cni", self.whitening, by_window).reshape(sets, -1)
        if not np.isfinite(errors).all():
            raise FloatingPointError(
                "the simulator returned values that are not finite: narrow its parameters' ranges"
            )
        return errors

    def _seen(self, rollout: TensorDictBase) -> torch.Tensor:
        """What is compared [N, instants, 6], each in units of its scale."""
        s = CHANNEL_SCALE
        scale = torch.tensor(
            [s["position"], s["position"], s["yaw"], s["vx"], s["vy"], s["yaw_rate"]]
        )
        pose = relative_pose(rollout[keys.POSE])[:, self.instants]
        velocity = rollout[keys.VELOCITY][:, self.instants]
        return torch.cat([pose, velocity], -1) / scale
