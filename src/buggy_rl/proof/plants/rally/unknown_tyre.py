"""Unknown effects between tyre and floor: dust, heat, pile, water."""

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Array, Arrays, col, limit, to_body, to_world
from buggy_rl.proof.plants.rally.body import wheel_places
from buggy_rl.proof.plants.rally.unknown_base import Unknown, slide_power


class DustFilm(Unknown):
    """Tyres pick up floor dust as they roll and wipe it off where they slide.

    Mechanism: the film grows towards full cover over a rolling length of 3 m and is worn by the
    sliding work (5 J clear most of it). size: share of grip lost under a full film.
    """

    name, low, high = "dust_film", 0.05, 0.6
    mechanism = "tyre dust film grows with metres rolled, is wiped off by sliding work, cuts grip"

    def start(self, state: Arrays) -> Arrays:
        """Film cover of each wheel, 0 to 1 [N, 4]."""
        return {self.key("cover"): col(0.5 * self.hidden(0)) * np.ones(4)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Grip falls with the cover."""
        inputs["grip"] = inputs["grip"] * (1.0 - self.wide * state[self.key("cover")])

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Pick-up by rolling, cleaning by sliding."""
        cover = state[self.key("cover")]
        rolled = np.abs(state["wheel"]) * col(self.k["radius"])
        change = rolled / 3.0 * (1.0 - cover) - slide_power(signals) / 5.0 * cover
        state[self.key("cover")] = limit(cover + dt * change, 0.0, 1.0)


class TreadHeat(Unknown):
    """The tread skin heats by sliding and its rubber loses grip until it has cooled.

    Mechanism: half of the sliding power warms a skin of 0.15 J/K, which cools into the carcass
    within 1.5 s; friction falls with the temperature rise and levels off (rubber friction above
    its optimum). size: share of grip lost by a very hot skin.
    """

    name, low, high = "tread_heat", 0.06, 0.7
    mechanism = "sliding power heats a thin tread skin that loses grip until it cools"

    def start(self, state: Arrays) -> Arrays:
        """Skin temperature above the carcass, K [N, 4]."""
        return {self.key("rise"): np.zeros((self.cars, 4))}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Grip falls with temperature, half of it at 8 K."""
        rise = state[self.key("rise")]
        inputs["grip"] = inputs["grip"] * (1.0 - self.wide * rise / (rise + 8.0))

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Heat balance of the skin."""
        rise = state[self.key("rise")]
        state[self.key("rise")] = rise + dt * (0.5 * slide_power(signals) / 0.15 - rise / 1.5)


class CarpetPile(Unknown):
    """Carpet fibres lean to one side: sliding against the pile grips more than along it.

    Mechanism: the friction depends on the world direction in which a patch slides relative to
    the lean; below 2 cm/s the fibres only bend. size: relative change of grip either way.
    """

    name, low, high = "carpet_pile", 0.03, 0.45
    mechanism = "carpet fibres lean: grip depends on the direction in which each patch slides"

    def start(self, state: Arrays) -> Arrays:
        """Cosine between sliding direction and lean, [N, 4]."""
        return {self.key("along"): np.zeros((self.cars, 4))}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Less grip with the pile, more against it."""
        inputs["grip"] = inputs["grip"] * (1.0 - self.wide * state[self.key("along")])

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Sliding direction of each patch in the world, relative to the lean direction."""
        x, y = signals["slip_x"], signals["slip_y"]
        cosine, sine = np.cos(signals["angle"]), np.sin(signals["angle"])
        x, y = to_world(state["yaw"], cosine * x - sine * y, sine * x + cosine * y)
        lean = 2.0 * np.pi * self.hidden(1)
        along = col(np.cos(lean)) * x + col(np.sin(lean)) * y
        state[self.key("along")] = along / (np.sqrt(x * x + y * y) + 0.02)


class WetSpill(Unknown):
    """Small puddles wet the tyres; each tyre stays slippery until it has rolled itself dry.

    Mechanism: puddles of 0.25 m radius lie on a 1.3 m lattice; a tyre is wet after 5 cm in one
    and dries over 1.5 m of rolling. size: share of grip lost by a wet tyre.
    """

    name, low, high = "wet_spill", 0.06, 0.7
    mechanism = "puddles at places wet single tyres, which stay slippery until rolled dry"

    def start(self, state: Arrays) -> Arrays:
        """Wetness of each tyre, 0 to 1 [N, 4]."""
        return {self.key("wet"): np.zeros((self.cars, 4))}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Grip falls with wetness."""
        inputs["grip"] = inputs["grip"] * (1.0 - self.wide * state[self.key("wet")])

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Wetting inside a puddle, drying outside, both over rolled length."""
        x, y = wheel_places(self.k, state)
        x, y = _to_lattice(x, self.hidden(2)), _to_lattice(y, self.hidden(3))
        inside = x * x + y * y < 0.25 * 0.25
        wet = state[self.key("wet")]
        rolled = dt * np.abs(state["wheel"]) * col(self.k["radius"])
        change = np.where(inside, (1.0 - wet) * rolled / 0.05, -wet * rolled / 1.5)
        state[self.key("wet")] = limit(wet + change, 0.0, 1.0)


def _to_lattice(place: Array, phase: Array, pitch: float = 1.3) -> Array:
    """Distance from the nearest lattice point along one axis, [N, 4]."""
    turned = place / pitch - col(phase)
    return pitch * (turned - np.floor(turned + 0.5))


class BoardBounce(Unknown):
    """A floor of loose boards: each board rocks on its joist under the car and swings back.

    Mechanism: the tilt of the floor below the car follows the car's place across the board with
    the second-order motion of the board (4 Hz, lightly damped), so weight pulls the car towards
    the low edge, with a delay and after-swing. Boards run along world y, 1.6 m wide.
    size: tilt, rad, when the car stands at the edge of a board.
    """

    name, low, high = "board_bounce", 0.004, 0.08
    mechanism = "loose floor boards rock with inertia under the car's weight and tilt it"

    def start(self, state: Arrays) -> Arrays:
        """Tilt, rad, and tilt rate of the board below, [N]."""
        return {self.key("tilt"): np.zeros(self.cars), self.key("rate"): np.zeros(self.cars)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Weight along the tilted board."""
        pull = self.k["mass"] * 9.81 * self.size * state[self.key("tilt")]
        x, y = to_body(state["yaw"], pull, np.zeros(self.cars))
        inputs["force_x"], inputs["force_y"] = inputs["force_x"] + x, inputs["force_y"] + y

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Motion of the board, relative to its tilt under a car at its edge."""
        place = 2.0 * _to_lattice(col(state["x"]), self.hidden(4), 1.6)[:, 0] / 1.6
        omega, tilt, rate = 2.0 * np.pi * 4.0, state[self.key("tilt")], state[self.key("rate")]
        rate = rate + dt * (omega * omega * (place - tilt) - 0.3 * omega * rate)
        state[self.key("tilt")], state[self.key("rate")] = tilt + dt * rate, rate


TYRE = (DustFilm, TreadHeat, CarpetPile, WetSpill, BoardBounce)
