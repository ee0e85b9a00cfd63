"""Files of films, read again."""

import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs, read_frames
from PIL import Image

from buggy_rl.visual.film.video import write_video


def frames(count=6):
    """Frame k is of the grey 40 k."""
    for k in range(count):
        yield np.full((64, 96, 3), 40 * k, np.uint8)


def test_an_mp4_has_every_frame_in_order(tmp_path):
    file = tmp_path / "folder" / "film.mp4"
    assert write_video(frames(), file, 25) == 6
    count, seconds = count_frames_and_secs(str(file))
    assert count == 6
    assert seconds == pytest.approx(6 / 25, abs=0.02)
    reader = read_frames(str(file))
    assert next(reader)["size"] == (96, 64)
    greys = [float(np.frombuffer(frame, np.uint8).mean()) for frame in reader]
    np.testing.assert_allclose(greys, 40 * np.arange(6), atol=4)


def test_a_gif_has_every_frame_and_repeats(tmp_path):
    file = tmp_path / "film.gif"
    varied = [np.random.default_rng(k).integers(0, 255, (64, 96, 3), np.uint8) for k in range(4)]
    write_video(iter(varied), file, 25)
    with Image.open(file) as image:
        assert image.n_frames == 4
        assert image.info["duration"] == 40
        assert image.info["loop"] == 0


def test_a_png_holds_the_last_frame(tmp_path):
    write_video(frames(3), tmp_path / "picture.png", 25)
    assert (np.asarray(Image.open(tmp_path / "picture.png")) == 80).all()


def test_an_unknown_ending_is_refused_before_anything_is_made(tmp_path):
    with pytest.raises(ValueError, match=r"film\.avi: the ending must be one of \.mp4, "):
        write_video(frames(), tmp_path / "film.avi", 25)


def test_a_film_that_fails_leaves_no_file(tmp_path):
    def failing():
        yield from frames(2)
        raise FloatingPointError("diverged")

    for name in ("film.mp4", "film.gif"):
        with pytest.raises(FloatingPointError):
            write_video(failing(), tmp_path / name, 25)
        with pytest.raises(ValueError, match="no frame"):
            write_video(iter(()), tmp_path / name, 25)
    assert list(tmp_path.iterdir()) == []


def test_a_gif_has_the_colours_of_its_last_frames_too(tmp_path):
    grey, amber = (np.full((64, 64, 3), c, np.uint8) for c in ((120, 120, 120), (237, 174, 73)))
    write_video([grey, grey, amber], tmp_path / "late.gif", 10)
    film = Image.open(tmp_path / "late.gif")
    film.seek(film.n_frames - 1)
    shown = np.asarray(film.convert("RGB"), int)
    assert np.abs(shown - [237, 174, 73]).max() < 8
