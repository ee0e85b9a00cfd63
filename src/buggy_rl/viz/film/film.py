"""A film from tracks to frames.

```python
says = director([from_rollout(rows, "mine", dt=0.01)])
write_video(frames(says, says.times(fps=25)), "film.mp4", fps=25)
```
"""

from collections.abc import Callable, Iterable, Iterator, Sequence

from buggy_rl.viz.film.director import Director
from buggy_rl.viz.film.inset import Inset, captioned
from buggy_rl.viz.film.options import PictureConfig
from buggy_rl.viz.film.renderer import opened
from buggy_rl.viz.film.shot import Frame, Shot
from buggy_rl.viz.film.track import Track


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
    with opened(*choice, picture.dimensions, picture.samples) as renderer:
        if renderer.note and on_note is not None:
            on_note(renderer.note)
        shots, shown = _twice(says.shot(time) for time in times)
        for frame in renderer.frames(shots):
            shot = shown()
            frame = Inset(picture.title).on(frame, shot) if picture.inset else frame
            yield captioned(frame, _caption(picture.captions, shot.time / says.tracks[0].duration))


def _caption(captions: Sequence[str], share: float) -> str:
    """The one for a share of the film; empty if there is none."""
    return captions[min(int(share * len(captions)), len(captions) - 1)] if captions else ""


def _twice(shots: Iterable[Shot]) -> tuple[Iterator[Shot], Callable[[], Shot]]:
    """The shots, and what gives them once more: a renderer may ask for the next one ahead."""
    kept: list[Shot] = []

    def passing() -> Iterator[Shot]:
        for shot in shots:
            kept.append(shot)
            yield shot

    return passing(), lambda: kept.pop(0)
