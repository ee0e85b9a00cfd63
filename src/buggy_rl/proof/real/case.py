"""A case: an untouched half of a car's recordings, the other half edited, and a simulator."""

from dataclasses import dataclass, field

from buggy_rl.proof.real.edits import EDITS

ENGINES = ("single_track", "mujoco", "learned")
FAMILIES = ("nothing", "one", "two", "unknown")


@dataclass(frozen=True)
class RealCase:
    """Everything that decides a case; `concealed` is the answer."""

    seed: int
    dataset: str
    """Whose recordings."""
    half: str
    """Half of them that is edited, such as `0a`; the simulator is fitted to the other."""
    engine: str
    """Simulator that was fitted, of `ENGINES`."""
    baseline: bool = False
    """Whether the other half is given."""
    concealed: dict[str, dict[str, float]] = field(default_factory=dict)
    """Edit -> parameter -> value."""

    def __post_init__(self) -> None:
        unknown = sorted(set(self.concealed) - set(EDITS))
        if unknown:
            raise ValueError(f"no edits {unknown}; available: {', '.join(EDITS)}")
        if self.engine not in ENGINES:
            raise ValueError(f"no engine {self.engine!r}; available: {', '.join(ENGINES)}")

    @property
    def id(self) -> str:
        """Name of its folders; independent of what is concealed."""
        return f"{self.seed:07d}"

    @property
    def plant(self) -> str:
        """What was driven: the car of the dataset."""
        return self.dataset

    @property
    def simulator(self) -> str:
        """What was fitted to it."""
        return self.engine

    @property
    def own_make(self) -> bool:
        """Whether the simulator has the equations of the car: none has those of a real one."""
        return False

    @property
    def cluster(self) -> str:
        """Recordings, and the simulator that was fitted to the others: other cases have both."""
        return f"{self.dataset} {self.half} {self.engine}"

    @property
    def pairing(self) -> str:
        """Car and simulator, as tables have them."""
        return f"{self.dataset} -> {self.engine}{', baseline' * self.baseline}"

    @property
    def truth(self) -> tuple[str, ...]:
        """What is concealed, sorted."""
        return tuple(sorted(self.concealed))

    @property
    def family(self) -> str:
        """nothing, one, two, or unknown where the library has no effect for it."""
        if any(not EDITS[name].known for name in self.concealed):
            return "unknown"
        return FAMILIES[len(self.concealed)]

    @property
    def unknown(self) -> bool:
        """Whether something differs that no effect describes.

        Without a baseline that is the form of the simulator, which is never that of a real car.
        """
        return self.family == "unknown" or (not self.concealed and self.differs_unseen)

    @property
    def differs_unseen(self) -> bool:
        """Whether no baseline shows how simulator and car differ: in their form they always do."""
        return not self.baseline

    @property
    def other(self) -> str:
        """The half that is not edited."""
        return self.half[:-1] + ("b" if self.half.endswith("a") else "a")
