"""Pictures of an environment as it is driven, one at a time: Gymnasium's and TorchRL's `render`."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.record import PixelRenderTransform

from buggy_rl import keys
from buggy_rl.task.paths.path_set import PathSet
from buggy_rl.vehicle import CONTROL_PERIOD, VehicleDimensions
from buggy_rl.viz.film.cameras import views
from buggy_rl.viz.film.film import studio
from buggy_rl.viz.film.inset import with_inset
from buggy_rl.viz.film.shot import Shot
from buggy_rl.viz.film.track import FULL_LOCK, Row

LAPS = 20  # of a closed path that are known ahead


class Still:
    """Draws the first car of an environment; each call is one control period after the last.

    Args:
        paths: That cars follow; None for an engine without a task.
        camera: chase, top or fixed.
        size: Width and height [pixels].
        renderer: rendered, drawn or auto.
        tell: Is told why it is drawn from above.
    """

    def __init__(
        self,
        paths: PathSet | None = None,
        camera: str = "chase",
        size: tuple[int, int] = (640, 480),
        renderer: str = "auto",
        tell: Callable[[str], object] = print,
    ) -> None:
        self.paths, self.camera, self.size = paths, camera, size
        self._studio = studio(renderer, size, 1, tell)
        self._trail: list[tuple[float, float]] = []
        self._roll = self._yaw = 0.0
        self._closed = 0

    def __call__(self, state: TensorDictBase) -> NDArray:
        """[H, W, 3] uint8 of a state, of the first car where there is a batch."""
        car = state.reshape(-1)[0]
        pose, vx = car[keys.POSE].double().tolist(), float(car[keys.VELOCITY][0])
        if self._trail and np.hypot(*np.subtract(pose[:2], self._trail[-1])) > 0.5:
            self.restart()  # it was set down elsewhere
        self._trail.append((pose[0], pose[1]))
        self._yaw += (pose[2] - self._yaw + np.pi) % (2 * np.pi) - np.pi
        self._roll += vx * CONTROL_PERIOD / VehicleDimensions().wheel_radius
        command = car.get(keys.LAST_ACTION, None)
        command = car.get(keys.ACTION, None) if command is None else command
        throttle, steering = (0.0, 0.0) if command is None else command.tolist()
        waypoints = self._waypoints(car)
        row = Row(
            (pose[0], pose[1], self._yaw),
            *(vx, throttle, steering, steering * FULL_LOCK, self._roll),
            CONTROL_PERIOD * (len(self._trail) - 1),
            self._closed,
        )
        shot = Shot(["car"], [row], [np.array(self._trail)], waypoints)
        points = np.array(self._trail) if waypoints is None else waypoints
        width, height = self.size
        [view] = views(self.camera, np.array([row.pose]), [points], 1.0, width / height)  # type: ignore[arg-type]
        return with_inset(self._studio.frame(shot, view), shot)

    def restart(self) -> None:
        """Forgets where the car has been."""
        self._trail.clear()
        self._roll, self._closed = 0.0, 0

    def close(self) -> None:
        """Ends the renderer."""
        self._studio.__exit__(None, None, None)

    def _waypoints(self, car: TensorDictBase) -> NDArray | None:
        if self.paths is None or car.get(keys.PATH, None) is None:
            return None
        path, following = int(car[keys.PATH]), int(car[keys.NEXT_WAYPOINT])
        self._closed = max(0, following - 1)
        closed = bool(self.paths.closed[path])
        ahead = LAPS * int(self.paths.count[path]) if closed else 0
        count = None if closed else int(self.paths.count[path])
        return self.paths.extended(ahead)[path, :count].double().numpy()


def with_pixels(env: EnvBase, still: Still | None = None, **options: Any) -> EnvBase:
    """An environment whose TensorDict has `pixels` [*, H, W, 3] uint8, by TorchRL's own transform.

    All rows of a batch have the picture of its first car.

    Follow it with `torchrl.record.VideoRecorder` for a film of a collector or an evaluation.

    Args:
        env: Any environment with pose and velocity.
        still: Draws; by default one that knows no path.
        options: Of `Still`, if none is given.
    """
    draw = still or Still(**options)

    def render(tensordict: TensorDictBase | None = None, **_: Any) -> torch.Tensor:
        state = env.reset() if tensordict is None else tensordict
        picture = torch.from_numpy(draw(state).copy())
        return picture.expand(*state.batch_size, *picture.shape)

    engine: Any = env
    while isinstance(engine, TransformedEnv):  # from which the transform's parent takes it
        engine = engine.base_env
    engine.render = render
    return env.append_transform(PixelRenderTransform(pass_tensordict=True, out_keys=["pixels"]))
