import imageio.v2 as imageio
import numpy as np
import pytest
from PIL import Image

from buggy_rl.viz.film.video import writing

RED, BLUE = [200, 30, 40], [30, 40, 200]


def written(file, count: int = 5):
    with writing(file, 10.0) as write:
        for index in range(count):
            write(np.full((48, 64, 3), RED if index < count - 1 else BLUE, np.uint8))


def test_an_mp4_has_all_frames_at_its_rate(tmp_path):
    written(tmp_path / "deep" / "film.mp4")
    with imageio.get_reader(tmp_path / "deep" / "film.mp4") as reader:
        assert reader.count_frames() == 5  # type: ignore[attr-defined]
        assert reader.get_meta_data()["fps"] == pytest.approx(10.0)
        assert reader.get_data(0).shape == (48, 64, 3)


def test_a_gif_loops_and_keeps_its_time(tmp_path):
    written(tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as image:
        assert image.info["loop"] == 0
        # Equal frames are one that is shown longer.
        assert image.info["duration"] == 400
        assert image.size == (64, 48)


def test_a_png_is_the_last_frame(tmp_path):
    written(tmp_path / "film.png")
    assert np.asarray(Image.open(tmp_path / "film.png"))[0, 0].tolist() == BLUE


def test_an_interrupted_film_leaves_nothing_behind(tmp_path):
    def interrupted() -> None:
        with writing(tmp_path / "film.gif", 10.0) as write:
            write(np.zeros((8, 8, 3), np.uint8))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_ending_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"film\.avi: must end in \.mp4, \.gif, \.png"):
        written(tmp_path / "film.avi")
