"""Unknown effects of the drive: controller temperature, clutch, grease, battery."""

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Arrays, limit
from buggy_rl.proof.plants.rally.unknown_base import Unknown


class ControllerHeat(Unknown):
    """The motor controller cuts its output when hot and restores it when it has cooled.

    Mechanism: loss grows with the current squared; above 85 degrees the output is cut until
    below 78 degrees, so the drive switches in and out. size: share of drive that is cut.
    """

    name, low, high = "controller_heat", 0.1, 1.0
    mechanism = "controller heats with current squared, cuts drive at one temperature, restores"

    def start(self, state: Arrays) -> Arrays:
        """Temperature, degrees, and whether cut, [N]."""
        return {self.key("warm"): 79.0 + 5.0 * self.hidden(4), self.key("cut"): np.zeros(self.cars)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Less drive while cut."""
        inputs["drive"] = inputs["drive"] * (1.0 - self.size * state[self.key("cut")])

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Heat balance and thresholds; a cut controller carries less current."""
        part = signals["current"] / self.k["stall_current"]
        part = part * (1.0 - self.size * state[self.key("cut")])
        warm = state[self.key("warm")]
        warm = warm + dt * (300.0 * part * part - (warm - 25.0) / 6.0)
        threshold = np.where(state[self.key("cut")] > 0.5, 78.0, 85.0)
        state[self.key("cut")] = (warm > threshold).astype(float)
        state[self.key("warm")] = warm


class SlipperClutch(Unknown):
    """A worn slipper clutch breaks loose under torque and fades with its own heat.

    Mechanism: the clutch carries less than the stall torque; once it slips it carries three
    quarters of the limit until both plates turn together, and the slip heat lowers the limit.
    size: missing share of the torque capacity.
    """

    name, low, high = "slipper_clutch", 0.6, 0.9
    mechanism = "clutch breaks loose above a torque, carries less while slipping, fades by heat"

    def start(self, state: Arrays) -> Arrays:
        """Heat of the plates, J [N]."""
        return {self.key("heat"): np.zeros(self.cars)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Limit torque; no limit where the size is zero."""
        limit_torque = 1.1 * self.k["stall_torque"] * (1.0 - self.size)
        limit_torque = limit_torque / (1.0 + state[self.key("heat")] / 10.0)
        inputs["clutch"] = np.where(self.active, limit_torque, inputs["clutch"])

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Slip power heats, the plates cool within 4 s."""
        capacity = self.k["stall_torque"] * (1.0 - self.size)
        heat, power = state[self.key("heat")], capacity * np.abs(state["clutch_slip"])
        state[self.key("heat")] = heat + dt * (power - heat / 4.0)


class ColdGrease(Unknown):
    """Cold grease in the gearbox drags until the drive has warmed it.

    Mechanism: viscous drag grows with rotor speed and falls exponentially with the temperature,
    which rises with the drag work (6 J/K of gears and grease). size: drag torque of cold grease
    at full speed over the stall torque.
    """

    name, low, high = "cold_grease", 0.01, 0.4
    mechanism = "viscous gear drag that decays as its own work warms the grease"

    def start(self, state: Arrays) -> Arrays:
        """Temperature rise, K [N]."""
        return {self.key("rise"): np.zeros(self.cars)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Drag torque on the rotor."""
        inputs["rotor_drag"] = inputs["rotor_drag"] + self._drag(state)

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Drag work warms the grease."""
        power = self._drag(state) * np.abs(state["rotor"])
        state[self.key("rise")] = state[self.key("rise")] + dt * power / 6.0

    def _drag(self, state: Arrays) -> np.ndarray:
        """Drag torque, N m [N]; shear thinning bounds it."""
        part = np.abs(state["rotor"]) * self.k["motor_constant"] / self.k["volts"]
        viscosity = np.exp(-state[self.key("rise")] / 5.0)
        return self.size * self.k["stall_torque"] * viscosity * 1.5 * part / (0.5 + part)


class VoltageRecovery(Unknown):
    """The battery polarises: after a strong pull its voltage stays low and recovers slowly.

    Mechanism: diffusion in the cells, a resistor-capacitor pair in series with the ohmic part
    (Thevenin model): the voltage across it follows the current with 0.5 s while loading and 3 s
    while resting. size: share of the drive lost in steady stall current.
    """

    name, low, high = "voltage_recovery", 0.1, 0.9
    mechanism = "cell polarisation follows the current fast up and slowly down and weakens drive"

    def start(self, state: Arrays) -> Arrays:
        """Polarisation, share of its value at stall current, [N]."""
        return {self.key("part"): 0.1 * self.hidden(5)}

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Less drive by the lost voltage."""
        inputs["drive"] = inputs["drive"] * (1.0 - self.size * state[self.key("part")])

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Charge and rest of the polarisation."""
        part, goal = state[self.key("part")], signals["current"] / self.k["stall_current"]
        lag = np.where(goal > part, 0.5, 3.0)
        state[self.key("part")] = limit(part + (goal - part) * dt / lag, 0.0, 1.0)


DRIVE = (ControllerHeat, SlipperClutch, ColdGrease, VoltageRecovery)
