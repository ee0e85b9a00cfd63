"""A film: tracks, from the side or from above, frame by frame."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from omegaconf import MISSING

GHOST_ALPHA = 0.4


@dataclass(frozen=True)
class FilmConfig:
    """What is filmed, and how."""

    what: str = MISSING
    """A recording (.csv, .parquet, bag, folder); a simulator (an engine's name, .yaml, .pt,
    file.py:factory); or a policy's .pt."""
    output: str = "runs/film.mp4"
    """The film: .mp4, .gif, or .png for its last frame."""
    ghost: str = ""
    """A second one of these, translucent beside the first."""
    then: str = ""
    """A ghost that takes the first one's place while the film runs a second time."""
    recording: str = ""
    """Whose commands simulators are given, from where it was; without one pure pursuit drives."""
    columns: str = ""
    """YAML column map of a recording without the standard columns."""
    course: str = "lap"
    """What is driven without a recording: lap, infinity, random, training or validation."""
    simulator: str = ""
    """What policies drive; empty for what each was trained in."""
    start: float = 0.0
    """Of the part of the recording [s]."""
    seconds: float = 10.0
    """Longest time that is shown [s]."""
    camera: str = "chase"
    """chase, top or fixed."""
    renderer: str = "auto"
    """rendered (MuJoCo, needs OpenGL), drawn (from above), or auto: rendered where that works."""
    size: list[int] = field(default_factory=lambda: [640, 480])
    """Width and height [pixels], even."""
    fps: float = 25.0
    """Frames a second."""
    speed: float = 1.0
    """Of the film over that of the car."""
    title: str = ""
    """Written above."""
    then_title: str = ""
    """Written above while it runs a second time."""
    seed: int = 0
    """Of whatever is random in a simulator."""
    live: bool = False
    """Shows it in MuJoCo's viewer, in a loop, instead of writing a film; needs a screen."""

    def __post_init__(self) -> None:
        for name in ("seconds", "fps", "speed"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}={getattr(self, name)}: must be above 0")
        if len(self.size) != 2 or any(pixels < 16 or pixels % 2 for pixels in self.size):
            raise ValueError(f"size={self.size}: must be an even width and height, as [640,480]")
        if self.renderer not in ("auto", "rendered", "drawn"):
            raise ValueError(f"renderer={self.renderer}: must be auto, rendered or drawn")


def tracks(config: FilmConfig, ghost: str, step: Callable[[], object] = lambda: None) -> list:
    """The film's own track, and that of a ghost if there is one.

    Args:
        config: What is filmed.
        ghost: A recording, a simulator or a policy; empty for none.
        step: Called at every step that is simulated.
    """
    from buggy_rl.viz.film.sources import Part, is_recording, read_recording, track_of

    both = [what for what in (config.what, ghost) if what]
    source = config.recording or next((what for what in both if is_recording(what)), "")
    part = Part(
        read_recording(source, config.columns) if source else None,
        *(config.start, config.seconds, config.course, config.simulator, config.seed),
    )
    return [track_of(what, part, step) for what in both]


def frames(
    config: FilmConfig,
    tracks: Sequence[Any],
    title: str = "",
    tell: Callable[[str], object] = print,
) -> tuple[Iterator[Any], int]:
    """Draws tracks.

    Args:
        config: How.
        tracks: The first one's car is solid, the second one's translucent.
        title: Written above.
        tell: Is told why a film is drawn from above.

    Returns:
        Iterator of the frames [H, W, 3] uint8, and their number.
    """
    import numpy as np

    from buggy_rl.vehicle import VehicleDimensions

    longest = max(track.duration for track in tracks)
    count = max(2, round(longest / config.speed * config.fps) + 1)
    times = np.arange(count) * config.speed / config.fps
    dimensions = VehicleDimensions()
    rows = [track.at(times, dimensions) for track in tracks]
    return _frames(config, tracks, rows, title, tell), count


def _frames(config: FilmConfig, tracks, rows, title: str, tell) -> Iterator[Any]:
    import numpy as np

    from buggy_rl.viz.film.cameras import views
    from buggy_rl.viz.film.inset import with_inset
    from buggy_rl.viz.film.shot import Shot

    places = [np.array([row.pose[:2] for row in own]) for own in rows]
    seen = [*places]
    if tracks[0].waypoints is not None:
        seen.append(tracks[0].waypoints)
    poses = np.array([row.pose for row in rows[0]])
    width, height = config.size
    looks = views(config.camera, poses, seen, config.fps, width / height)  # type: ignore[arg-type]
    with studio(config.renderer, (width, height), len(tracks), tell) as drawing:
        for index, view in enumerate(looks):
            shot = Shot(
                [track.name for track in tracks],
                [own[index] for own in rows],
                [own[: index + 1] for own in places],
                tracks[0].waypoints,
            )
            yield with_inset(drawing.frame(shot, view), shot, title)


def studio(
    renderer: str, size: tuple[int, int], cars: int, tell: Callable[[str], object] = print
) -> Any:
    """What draws: MuJoCo's renderer, or a drawing from above.

    Args:
        renderer: rendered, drawn, or auto for the first that works.
        size: Width and height of the frames [pixels].
        cars: The first is solid, a second one translucent.
        tell: Is told why it is drawn from above.

    Raises:
        ValueError: Nothing can render here, and nothing else will do.
    """
    from buggy_rl.viz.film.drawn import Drawn
    from buggy_rl.viz.film.gl import advice, backend
    from buggy_rl.viz.film.rendered import Rendered

    alphas = [1.0, GHOST_ALPHA][:cars]
    if renderer == "drawn":
        return Drawn(alphas, size)
    if backend():
        return Rendered(alphas, size)
    if renderer == "rendered":
        raise ValueError(f"renderer=rendered: {advice()}")
    tell(advice())
    return Drawn(alphas, size)


def film(config: FilmConfig, progress: Callable[..., Any], tell: Callable[[str], object]) -> Path:
    """Writes the film of a config.

    Args:
        config: What is filmed, and how.
        progress: As `tqdm`: wraps the frames, or counts steps.
        tell: Is told what the user ought to know.
    """
    from buggy_rl.viz.film.video import check_output, writing

    output = check_output(config.output)
    ghosts = [(config.ghost, config.title)]
    ghosts += [(config.then, config.then_title)] if config.then else []
    with progress(desc="driving", unit="step") as bar:
        found = [(tracks(config, ghost, bar.update), title) for ghost, title in ghosts]
    parts = [frames(config, shown, title, tell) for shown, title in found]
    all_, count = chain(*(drawn for drawn, _ in parts)), sum(count for _, count in parts)
    with writing(output, config.fps) as write:
        for frame in progress(all_, desc="drawing", unit="frame", total=count):
            write(frame)
    return output
