"""As much of pygame as a joystick needs, with SDL's behaviour: a trigger is 0 until it moves."""

import types

JOYAXISMOTION, JOYDEVICEADDED, JOYDEVICEREMOVED = 1536, 1541, 1542


class FakePygame(types.ModuleType):
    """A module with one pad, that can be moved, pulled out and plugged in again."""

    def __init__(self, plugged=True):
        super().__init__("pygame")
        self.JOYAXISMOTION, self.JOYDEVICEADDED = JOYAXISMOTION, JOYDEVICEADDED
        self.JOYDEVICEREMOVED = JOYDEVICEREMOVED
        self.axes, self.buttons, self.events = [0.0] * 6, [0] * 11, []
        self.plugged, self.generation, self.ended = plugged, 0, False
        self.joystick = types.SimpleNamespace(
            init=lambda: None,
            quit=self._quit,
            get_count=lambda: int(self.plugged),
            Joystick=lambda index: Pad(self, self.generation),
        )
        self.event = types.SimpleNamespace(get=self._taken)

    def init(self):
        """Nothing to do."""

    def move(self, axis, value):
        self.axes[axis] = value
        self.events.append(types.SimpleNamespace(type=JOYAXISMOTION, axis=axis))

    def plug(self, there):
        self.plugged = there
        self.generation += there
        self.axes = [0.0] * 6
        kind = JOYDEVICEADDED if there else JOYDEVICEREMOVED
        self.events.append(types.SimpleNamespace(type=kind))

    def _taken(self):
        taken, self.events = self.events, []
        return taken

    def _quit(self):
        self.ended = True


class Pad:
    """A pad as it was plugged in; one from before the last plugging shows nothing any more."""

    def __init__(self, world, generation):
        self._world, self._generation = world, generation

    def _now(self, values, index):
        return values[index] if self._generation == self._world.generation else 0

    def get_axis(self, axis):
        return self._now(self._world.axes, axis)

    def get_button(self, button):
        return self._now(self._world.buttons, button)
