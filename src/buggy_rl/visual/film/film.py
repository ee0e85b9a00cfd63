"""A film from tracks to frames.

```python
says = director([from_rollout(rows, "mine", dt=0.01)])
write_video(frames(says, says.times(fps=25)), "film.mp4", fps=25)
```
"""

import base64
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, TransformedEnv

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.visual.film.canvas import Inset, captioned
from buggy_rl.visual.film.director import Director
from buggy_rl.visual.film.options import PictureConfig
from buggy_rl.visual.film.renderer import Renderer, make_renderer, open_renderer
from buggy_rl.visual.film.shot import Frame, Shot
from buggy_rl.visual.film.source import course_of
from buggy_rl.visual.film.track import Track
from buggy_rl.visual.film.video import write_video


def director(tracks: Sequence[Track], picture: PictureConfig | None = None) -> Director:
    """Who says what each frame shows of up to three tracks; the first is the car's."""
    picture = picture or PictureConfig()
    aspect = picture.size[0] / picture.size[1]
    return Director(tracks, picture.camera, aspect, picture.full_lock, picture.dimensions)


def frames(
    says: Director,
    times: Iterable[float],
    picture: PictureConfig | None = None,
    on_note: Callable[[str], None] | None = None,
) -> Iterator[Frame]:
    """Yields the frames [H, W, 3] of a film.

    Args:
        says: From `director`.
        times: Of the frames [s], such as `says.times(fps)`.
        picture: How it is shown.
        on_note: Told what the user should know, such as why it is drawn and not rendered.

    Raises:
        ValueError: An option is wrong, or MuJoCo is asked for and cannot render.
    """
    picture = picture or PictureConfig()
    width, height = picture.size
    choice = (picture.renderer, (width, height), len(says.tracks) - 1)
    with open_renderer(*choice, picture.dimensions, picture.samples) as renderer:
        if renderer.note and on_note is not None:
            on_note(renderer.note)
        shots, shown = _twice(says.shot(time) for time in times)
        for frame in renderer.frames(shots):
            shot = shown()
            frame = Inset(picture.title).on(frame, shot) if picture.inset else frame
            yield captioned(frame, _caption(picture.captions, shot.time / says.tracks[0].duration))


def _caption(captions: Sequence[str], share: float) -> str:
    """Caption for a share of the film; empty if there is none."""
    return captions[min(int(share * len(captions)), len(captions) - 1)] if captions else ""


def _twice(shots: Iterable[Shot]) -> tuple[Iterator[Shot], Callable[[], Shot]]:
    """The shots, and what gives them once more: a renderer may ask for the next one ahead."""
    kept: list[Shot] = []

    def passing() -> Iterator[Shot]:
        for shot in shots:
            kept.append(shot)
            yield shot

    return passing(), lambda: kept.pop(0)


FPS = 12.5  # of the film; a gif's frames last a multiple of 10 ms
PLAYBACK = 0.5  # seconds of driving in a second of film
PICTURE = PictureConfig(camera="together", size=[480, 340], renderer="drawing")


def embedded_film(tracks: Sequence[Track], length: float = 1.0) -> str:
    """A gif of up to three tracks in slow motion, drawn from above, as a data URI.

    Args:
        tracks: The car's, then those of the ghosts.
        length: Of the car over the buggy's, at whose size it is drawn.
    """
    says = director([track.drawn_at(length) for track in tracks], PICTURE)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "film.gif"
        write_video(frames(says, says.times(FPS, PLAYBACK), PICTURE), file, FPS)
        return f"data:image/gif;base64,{base64.b64encode(file.read_bytes()).decode()}"


MOST = 16  # environments of a batch; each takes as long as a film's frame
LEAP = 0.5  # [m] in a control period, which only a reset can do
REMEMBERED = 3000  # rows, 30 s: trail, camera and the roll of the wheels


class Pixels:
    """Remembers where the cars of an environment were and draws where they are.

    Commands are shown as far as states carry `last_action`, as those of the default task do.

    Args:
        env: Any, with or without a task; its path is drawn if it has one.
        picture: How it is shown.

    Raises:
        ValueError: The batch is too large, or an option is wrong.
    """

    def __init__(self, env: EnvBase, picture: PictureConfig | None = None) -> None:
        self._count = env.batch_size.numel()
        if self._count > MOST:
            raise ValueError(
                f"{self._count} environments are too many to draw: the most are {MOST}; make one "
                "with a batch_size of its own to look at"
            )
        self._env, self._batch = env, tuple(env.batch_size)
        self._picture = picture or PictureConfig()
        self._dt = float(getattr(env, "dt", CONTROL_PERIOD))
        self._rows: list[list[NDArray[Any]]] = [[] for _ in range(self._count)]
        self._path = [0] * self._count
        self._renderer: Renderer | None = None

    def __call__(self, state: TensorDictBase) -> Frame:
        """Pixels [*batch, H, W, 3] of a state, remembered."""
        self.record(state)
        return self.frame()

    def record(self, state: TensorDictBase) -> None:
        """Remembers a state, and forgets those before a reset."""
        for index, row in enumerate(_columns(state, self._count)):
            known = self._rows[index]
            leapt = bool(known) and np.hypot(*(row[:2] - known[-1][:2])) > LEAP
            if leapt or row[9] == 0:
                known.clear()
            known.append(row)
            del known[:-REMEMBERED]
        path = state.get(keys.PATH, None)
        if path is not None:
            self._path = path.flatten().tolist()

    def forget(self) -> None:
        """Begins anew, as after a reset; states with a `step_count` tell of theirs themselves."""
        for known in self._rows:
            known.clear()

    def frame(self) -> Frame:
        """Pixels [*batch, H, W, 3] of the last state.

        Raises:
            RuntimeError: No state was recorded.
        """
        if not all(self._rows):
            raise RuntimeError("render before reset: call reset first")
        found = [self._drawn(index) for index in range(self._count)]
        return np.stack(found).reshape(*self._batch, *found[0].shape)

    def close(self) -> None:
        """Ends the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _drawn(self, index: int) -> Frame:
        rows = self._rows[index]
        columns = np.array(rows if len(rows) > 1 else rows * 2)  # a track has two rows at least
        time = self._dt * np.arange(len(columns))
        course = course_of(self._env, self._path[index])
        following = columns[:, 8].astype(np.int64) if course is not None else np.zeros(0, np.int64)
        track = Track("car", time, columns[:, :3], columns[:, 3:6], columns[:, 6:8], course,
                      following)  # fmt: skip
        shot = director([track], self._picture).shot(track.duration)
        (frame,) = self._opened().frames([shot])
        return Inset(self._picture.title).on(frame, shot) if self._picture.inset else frame

    def _opened(self) -> Renderer:
        if self._renderer is None:
            picture = self._picture
            size = picture.size[0], picture.size[1]
            self._renderer = make_renderer(
                picture.renderer, size, False, picture.dimensions, picture.samples
            )
            if self._renderer.note:
                warnings.warn(self._renderer.note, stacklevel=2)
        return self._renderer

    def __del__(self) -> None:
        if getattr(self, "_renderer", None) is not None:
            self.close()


def renderable(env: EnvBase, picture: PictureConfig | None = None) -> EnvBase:
    """Gives an environment a `render(tensordict)`, for TorchRL's transforms.

    The state rides in the TensorDict, so `render` has to be given it:
    `renderable(env).append_transform(PixelRenderTransform(pass_tensordict=True))`.

    Args:
        env: Any of up to 16 cars, a user's own included.
        picture: How it is shown.
    """
    base: Any = env
    while isinstance(base, TransformedEnv):
        base = base.base_env
    base.render = Pixels(env, picture)
    return env


def _columns(state: TensorDictBase, count: int) -> NDArray[Any]:
    """Pose, velocity, action, next waypoint and step count [N, 10]; -1 is no step count."""
    motion = [state[key].detach().cpu() for key in (keys.POSE, keys.VELOCITY)]
    parts: list[NDArray[Any]] = [part.double().reshape(count, 3).numpy() for part in motion]
    defaults = ((keys.LAST_ACTION, [-1.0, 0.0]), (keys.NEXT_WAYPOINT, [1.0]),
                (keys.STEP_COUNT, [-1.0]))  # fmt: skip
    for key, default in defaults:
        value = state.get(key, None)
        if value is None:
            parts.append(np.tile(default, (count, 1)))
        else:
            parts.append(value.detach().cpu().double().reshape(count, -1).numpy())
    return np.concatenate(parts, 1)
