"""Options of a film: how it is shown, and what `scripts/render.py` takes."""

from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

from omegaconf import MISSING

from buggy_rl.core.car_file import load_car
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film.wheels import FULL_LOCK

Camera = Literal["chase", "top", "fixed", "together"]
Choice = Literal["auto", "mujoco", "drawing"]
Live = Literal[False, True, "window", "browser"]


@dataclass(frozen=True)
class PictureConfig:
    """How it is shown; `RenderConfig` explains each number."""

    camera: Camera = "chase"
    size: list[int] = field(default_factory=lambda: [640, 480])
    renderer: Choice = "auto"
    samples: int = 4
    inset: bool = True
    title: str = ""
    captions: list[str] = field(default_factory=list)
    full_lock: float = FULL_LOCK
    dimensions: VehicleDimensions = field(default_factory=VehicleDimensions)

    def __post_init__(self) -> None:
        if len(self.size) != 2:
            raise ValueError(f"size={list(self.size)}: must be width and height, as [640,480]")
        for text in self.captions:
            if not isinstance(text, str):
                raise ValueError(f"captions: {text!r} is no text; put quotes around a colon")


@dataclass(frozen=True)
class RenderConfig:
    """A film of a recording, a simulator or a policy."""

    what: str = MISSING
    """A recording, a simulator (as every script takes it), a policy file, pure_pursuit, stanley."""
    ghost: Any = ""
    """The second trajectory, likewise; a list for a second and a third; empty for none."""
    output: str = "film.mp4"
    """The film: .mp4 or .gif, or .png for one picture."""
    recording: str = ""
    """Commands that simulators are given; empty for those of WHAT or GHOST, if one is a
    recording."""
    start: float = 0.0
    """Start of the film within a recording [s]."""
    seconds: float = 10.0
    """Driving time at most [s]."""
    restart: float = 0.0
    """A simulator starts again from the recording after so many seconds; 0 for never."""
    columns: str = ""
    """Column map of recordings, a YAML file."""
    simulator: str = ""
    """What policies drive; empty for the one they were trained in, or mujoco."""
    course: str = "lap"
    """Course on which policies drive: lap, infinity, random, training, validation, or a CSV file of
    x, y."""
    camera: Camera = "chase"
    """Camera behind the car, above it (top), standing where all can be seen (fixed), or as near as
    all cars fit (together)."""
    size: list[int] = field(default_factory=lambda: [640, 480])
    """Width and height [pixel]."""
    fps: float = 25.0
    """Frames a second."""
    playback: float = 1.0
    """Seconds of driving in a second of film; 0.25 is slow motion."""
    moment: float = -1.0
    """Moment of the picture in a .png [s]; below 0 is the middle of the film."""
    live: Live = False
    """Plays instead of writing a film: in MuJoCo's viewer (window), in the browser, or (true) in
    the former where there is a screen and else in the latter."""
    renderer: Choice = "auto"
    """MuJoCo where OpenGL works and else a drawing from above (auto), or one of them."""
    samples: int = 4
    """Samples of each pixel against jagged edges, in MuJoCo; 0 takes half the time."""
    inset: bool = True
    """Names, speed and commands in a corner."""
    title: str = ""
    """Title above the names."""
    names: list[str] = field(default_factory=list)
    """Names of WHAT and of the ghosts in the legend; empty for those of their files."""
    captions: list[str] = field(default_factory=list)
    """Captions at the top, one after the other, each for an equal part of the film."""
    full_lock: float = FULL_LOCK
    """Angle of the front wheels at steering 1 [rad]."""
    dimensions: VehicleDimensions = field(default_factory=VehicleDimensions)
    car: str = ""
    """The car, by name or file: its dimensions, paths, and the limits of its recordings."""
    seed: int = 0
    """Seed of starts and noise."""
    threads: int = 1
    """Threads of PyTorch."""

    def __post_init__(self) -> None:
        for name in ("fps", "playback", "seconds"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}={getattr(self, name):g}: must be above 0")
        for name in ("start", "restart"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}={getattr(self, name):g}: must not be below 0")

        if not all(isinstance(name, str) for name in self.trajectories):
            raise ValueError(f"ghost={self.ghost!r}: must be a name or a list of names")
        if self.names and len(self.names) != len(self.trajectories):
            raise ValueError(
                f"names={list(self.names)}: must be {len(self.trajectories)}, one for each of "
                f"{', '.join(self.trajectories)}"
            )

    @property
    def trajectories(self) -> list[str]:
        """What is filmed, the ghosts last."""
        ghosts = list(self.ghost) if isinstance(self.ghost, list) else [self.ghost]
        return [name for name in (self.what, *ghosts) if name]

    @property
    def picture(self) -> PictureConfig:
        """The part of it that says how it is shown."""
        values = {f.name: getattr(self, f.name) for f in fields(PictureConfig)}
        if self.car:  # drawn as a model of the buggy's wheelbase, as its tracks are
            car = load_car(self.car)
            lengths = {f.name for f in fields(VehicleDimensions)} - {"mass", "yaw_inertia"}
            reduced = {n: getattr(car.vehicle, n) / car.similarity.length for n in lengths}
            values["dimensions"] = replace(car.vehicle, **reduced)
        return PictureConfig(**values)
