"""A shot: everything that one frame shows."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from numpy.typing import NDArray

from buggy_rl.viz.film.track import Row

AHEAD, BEHIND = 40, 15  # waypoints that are shown of a path


@dataclass(frozen=True, eq=False)
class Shot:
    """One instant of all cars, with the way behind them and the path ahead."""

    names: Sequence[str]
    rows: Sequence[Row]
    """Of each car; the first one's is the film's own."""
    trails: Sequence[NDArray]
    """[N, 2] of each car: where it has been [m]."""
    waypoints: NDArray | None = None
    """[W, 2] of the first car's path."""

    def paths(self) -> Iterator[tuple[NDArray, bool]]:
        """Parts [N, 2] of the path, from a waypoint on, and whether they are behind the car."""
        if self.waypoints is not None:
            closed = self.rows[0].closed
            yield self.waypoints[max(0, closed - BEHIND) : closed + 1], True
            yield self.waypoints[closed : closed + AHEAD], False
