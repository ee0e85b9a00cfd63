"""Whether the car may drive: disarmed until a person presses the button with all in order."""


class Arming:
    """Arms on a press of the hold-to-drive button, which must have been released before.

    A press while something is in the way is used up: the button must be released and pressed again.
    """

    def __init__(self) -> None:
        self.armed = False
        self.message = "release and press the button to arm"
        """Why the car is armed or not."""
        self._released = False

    def disarm(self, reason: str) -> None:
        """Takes the drive away until the next press."""
        self.armed, self.message, self._released = False, reason, False

    def update(self, hold: bool, obstacle: str) -> None:
        """Takes the button's state.

        Args:
            hold: The button is pressed now.
            obstacle: What forbids to arm; empty if nothing does.
        """
        if not hold:
            if self.armed:
                self.disarm("the button was released")
            self._released = True
        elif self._released:
            self._released = False
            self.armed = not obstacle
            self.message = f"cannot arm: {obstacle}" if obstacle else "armed"
