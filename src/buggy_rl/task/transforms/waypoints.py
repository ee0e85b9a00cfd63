"""What a car follows: the next waypoints of a path, which of them it has closed, a target speed."""

from functools import partial
from typing import Literal

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.data import Binary

from buggy_rl.core import keys
from buggy_rl.core.vehicle import wrap_angle
from buggy_rl.task.paths.path_set import PathSet
from buggy_rl.task.transforms.base import (
    COUNT,
    RandomTransform,
    measured_pose,
    unbounded_spec,
)

ENDLESS = 2**40  # waypoints of a closed path; more than a car can close


class Waypoints(RandomTransform):
    """Shows the next waypoints and closes those that the car passes.

    Waypoint w with tangent t is closed by a car at p when

        (p - w) . t > 0  and  |(p - w) x t| <= lateral_bound,

    the first being the original study's det(w - p, n) < 0 with n the normal to the left. Waypoints
    close one after the other: in one step as many as meet this in a row from the next one on, at
    most `at_once`. A car beyond the bound has closed nothing; it can still come back.

    On a closed path the queue goes on for ever. An open path is complete when its last waypoint
    is closed; the queue then holds waypoints straight ahead, none of which can be closed.

    Lateral and heading error are against the straight piece that ends at the next waypoint. The
    waypoints shown are seen from the measured pose; everything else goes by the true one.

    Args:
        paths: What to follow.
        visible: Waypoints shown.
        lateral_bound: [m] beside a waypoint that still counts.
        order: Which path at a reset: `random`, or `fixed`, the car's own index.
        start_lateral: Farthest that a car is set down beside the path's start [m].
        start_heading: Farthest that it is turned from the path's direction there [rad].

    Raises:
        ValueError: `order` is unknown.
    """

    before: tuple[str, ...] = (keys.OBSERVATION,)
    remembers: tuple[str, ...] = (keys.PATH, keys.NEXT_WAYPOINT)

    def __init__(
        self,
        paths: PathSet,
        visible: int = 10,
        lateral_bound: float = 0.5,
        at_once: int = 3,
        order: Literal["random", "fixed"] = "random",
        start_lateral: float = 0.0,
        start_heading: float = 0.0,
    ) -> None:
        super().__init__()
        if order not in ("random", "fixed"):
            raise ValueError(f"waypoints: order is {order!r}: must be random or fixed")
        self.paths, self.visible, self.at_once = paths, visible, at_once
        self.lateral_bound, self.order = lateral_bound, order
        self.start_lateral, self.start_heading = start_lateral, start_heading
        self._make_tables()
        self.writes = {
            keys.PATH: COUNT,
            keys.NEXT_WAYPOINT: COUNT,
            keys.WAYPOINTS: unbounded_spec(visible, 2),
            keys.WAYPOINTS_CLOSED: unbounded_spec(1),
            keys.PATH_POSITION: unbounded_spec(1),
            keys.LATERAL_ERROR: unbounded_spec(1),
            keys.HEADING_ERROR: unbounded_spec(1),
            keys.COMPLETED: Binary(1, dtype=torch.bool),
        }

    def _make_tables(self) -> None:
        """Tables that steps look up in, the waypoints of all paths one behind the other.

        `lines` [4, R] is x, y and tangent of each waypoint; `pieces` [7, R] the straight piece that
        ends there: its end x, y, direction x, y, length, distance of its end along the path, yaw.
        """
        paths, ahead = self.paths, self.visible + 1  # a completed path still shows a full queue
        points = paths.extended(ahead)  # (P, W', 2)
        chord = torch.cat([paths.before(), points], 1).diff(dim=1)
        length = chord.norm(dim=-1, keepdim=True)
        run = length.clone()
        run[:, 0] = 0.0
        path = torch.arange(len(paths))
        position = run.double().cumsum(1).float()
        lap = position[path, paths.count - 1, 0] + length[:, 0, 0]
        along = chord / length
        yaw = torch.atan2(along[..., 1:], along[..., :1])
        lines = torch.cat([points, paths.tangents(ahead)], -1)
        pieces = torch.cat([points, along, length, position, yaw], -1)
        turned = torch.stack([points[..., 1], -points[..., 0]], -1)
        table = partial(nn.Buffer, persistent=False)
        self.offset = table(path * points.shape[1])
        self.modulus = table(torch.where(paths.closed, paths.count, ENDLESS))
        self.last = table(torch.where(paths.closed, ENDLESS, paths.count))
        self.lap = table(lap)
        self.start = table(paths.start)
        self.points = table(points.flatten(0, 1))
        self.turned = table(turned.flatten(0, 1))
        self.lines = table(lines.flatten(0, 1).T.contiguous())
        self.pieces = table(pieces.flatten(0, 1).T.contiguous())
        self.places = table(torch.arange(self.visible))

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        # A path, and the pose that it starts at, unless the caller gives them.
        if tensordict is None:
            parent = self.parent
            assert parent is not None
            tensordict = TensorDict(batch_size=parent.batch_size, device=parent.device)
        if tensordict.get(keys.PATH, None) is None:
            tensordict.set(keys.PATH, self._chosen(tensordict))
        if tensordict.get(keys.POSE, None) is None:
            tensordict.set(keys.POSE, self._set_down(tensordict.get(keys.PATH)))
        return tensordict

    def last_closed(self, tensordict: TensorDictBase) -> Tensor:
        """Pose [*, 3] on the waypoint that each car closed last, along the path to the next."""
        row = self._row(tensordict.get(keys.PATH), tensordict.get(keys.NEXT_WAYPOINT))
        end_x, end_y, along_x, along_y, length, _, yaw = _columns(self.pieces, row)
        return torch.cat([end_x - length * along_x, end_y - length * along_y, yaw], -1)

    def _set_down(self, path: Tensor) -> Tensor:
        """Pose [*, 3] about the start of `path` [*, 1]."""
        start = self.start[path.squeeze(-1)]
        if not (self.start_lateral or self.start_heading):
            return start
        kind = {"dtype": start.dtype, "device": start.device}
        drawn = torch.rand(2, *path.shape, generator=self.generator, **kind)
        beside, turn = (2 * drawn - 1).unbind(0)
        x, y, yaw = start.split(1, -1)
        beside = self.start_lateral * beside
        moved = [x - beside * torch.sin(yaw), y + beside * torch.cos(yaw)]
        return torch.cat([*moved, yaw + self.start_heading * turn], -1)

    def _chosen(self, tensordict: TensorDictBase) -> Tensor:
        """Paths [*, 1] to begin with."""
        shape = tensordict.batch_size
        count, device = len(self.paths), self.lines.device
        if self.order == "random":
            return torch.randint(count, (*shape, 1), generator=self.generator, device=device)
        own = tensordict.get(keys.ENVIRONMENT, None)
        if own is None:
            own = torch.arange(shape.numel(), device=device).reshape(*shape, 1)
        return own % count

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        path = tensordict.get(keys.PATH)
        begin = tensordict.get(keys.NEXT_WAYPOINT, None)
        begin = torch.ones_like(path) if begin is None else begin
        self._refuse_ignored(tensordict.get(keys.POSE), tensordict_reset.get(keys.POSE))
        return self._write(tensordict_reset, path, begin, torch.zeros_like(begin))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        path, following = tensordict.get(keys.PATH), tensordict.get(keys.NEXT_WAYPOINT)
        closed = self._closed(next_tensordict.get(keys.POSE), path, following)
        return self._write(next_tensordict, path, following + closed, closed)

    def _refuse_ignored(self, asked: Tensor, found: Tensor) -> None:
        if not found.any() and asked.any():
            raise ValueError(
                "waypoints: a reset ignored the pose that it was given, and put the cars at the "
                "origin: begin at `pose` in the simulator's _reset, and put transforms over it by "
                "make_env or StackedEnv"
            )

    def _row(self, path: Tensor, waypoint: Tensor) -> Tensor:
        """Place of a waypoint in the tables, same shape."""
        return self.offset[path] + waypoint % self.modulus[path]

    def _closed(self, pose: Tensor, path: Tensor, following: Tensor) -> Tensor:
        """Number [*, 1] of waypoints that a car at `pose` [*, 3] closes."""
        row = self._row(path, following)
        rows = torch.stack([row + place for place in range(self.at_once)])  # (K, *, 1)
        wx, wy, tx, ty = _columns(self.lines, rows)
        dx, dy = pose[..., :1] - wx, pose[..., 1:2] - wy
        passed = (dx * tx + dy * ty > 0) & ((dx * ty - dy * tx).abs() <= self.lateral_bound)
        closed = torch.zeros_like(following)
        in_a_row = torch.ones_like(passed[0])
        for one in passed:
            in_a_row = in_a_row & one
            closed = closed + in_a_row
        return torch.minimum(closed, self.last[path] - following)

    def _write(
        self, td: TensorDictBase, path: Tensor, following: Tensor, closed: Tensor
    ) -> TensorDictBase:
        row = self._row(path, following)
        x, y, yaw = td.get(keys.POSE).split(1, -1)
        end_x, end_y, along_x, along_y, length, position, path_yaw = _columns(self.pieces, row)
        dx, dy = x - end_x, y - end_y
        # How far the car is short of the piece's end, within the piece, and how far beside it.
        short = -(dx * along_x + dy * along_y)
        within = torch.minimum(short.clamp_min(0.0), length)
        beside = along_x * dy - along_y * dx
        off = short - within
        ends = off != 0
        # Beside the piece itself the distance is |beside|, where hypot(0, 0) has no gradient.
        distance = torch.hypot(torch.where(ends, off, 1.0), beside)
        lateral = torch.where(ends, torch.copysign(distance, beside), beside)
        laps = following // self.modulus[path]
        td.set(keys.PATH, path)
        td.set(keys.NEXT_WAYPOINT, following)
        td.set(keys.WAYPOINTS, self._seen(measured_pose(td), row))
        td.set(keys.WAYPOINTS_CLOSED, closed.to(x.dtype))
        td.set(keys.PATH_POSITION, laps * self.lap[path] + position - within)
        td.set(keys.LATERAL_ERROR, lateral)
        td.set(keys.HEADING_ERROR, wrap_angle(yaw - path_yaw))
        td.set(keys.COMPLETED, following >= self.last[path])
        return td

    def _seen(self, pose: Tensor, row: Tensor) -> Tensor:
        """Waypoints [*, V, 2] from `row` [*, 1] on, in the frame of cars at `pose` [*, 3]."""
        x, y, yaw = pose.split(1, -1)
        cos, sin = torch.cos(yaw), torch.sin(yaw)
        # R(-yaw) (w - p) = cos w + sin turned(w) - R(-yaw) p, with turned(x, y) = (y, -x).
        own = torch.cat([cos * x + sin * y, cos * y - sin * x], -1).unsqueeze(-2)  # (*, 1, 2)
        rows = row + self.places  # (*, V)
        shape = (*rows.shape, 2)
        points = self.points.index_select(0, rows.flatten()).view(shape)
        turned = self.turned.index_select(0, rows.flatten()).view(shape)
        ahead = torch.addcmul(cos.unsqueeze(-1) * points, sin.unsqueeze(-1), turned)
        return ahead - own


def _columns(table: Tensor, rows: Tensor) -> tuple[Tensor, ...]:
    """Columns `rows` [*] of a table [C, R], as C tensors [*]."""
    return table.index_select(1, rows.flatten()).unflatten(1, rows.shape).unbind(0)


class TargetSpeed(RandomTransform):
    """v* ~ U(low, high), the same for an episode; writing `target_speed` in between changes it.

    Args:
        low: [m/s]
        high: [m/s]; equal to `low` for one speed always.
    """

    before: tuple[str, ...] = (keys.OBSERVATION,)
    remembers: tuple[str, ...] = (keys.TARGET_SPEED,)

    def __init__(self, low: float = 1.0, high: float = 3.0) -> None:
        super().__init__()
        if not 0 <= low <= high:
            raise ValueError(f"target_speed: low {low} and high {high} m/s are no range above 0")
        self.low, self.high = low, high
        self.writes = {keys.TARGET_SPEED: unbounded_spec(1)}

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        pose = next_tensordict.get(keys.POSE)
        shape = (*pose.shape[:-1], 1)
        kind = {"dtype": torch.float32, "device": pose.device}
        share = torch.rand(shape, generator=self.generator, **kind)
        return next_tensordict.set(keys.TARGET_SPEED, self.low + (self.high - self.low) * share)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(keys.TARGET_SPEED, tensordict.get(keys.TARGET_SPEED))
