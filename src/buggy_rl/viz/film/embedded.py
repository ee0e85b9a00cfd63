"""A short film as a data URI, for a page that refers to nothing outside itself."""

import base64
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from buggy_rl.viz.film.film import director, frames
from buggy_rl.viz.film.options import PictureConfig
from buggy_rl.viz.film.track import Track
from buggy_rl.viz.film.video import write_video

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
