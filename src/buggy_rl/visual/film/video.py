"""Frames -> mp4, gif or png, by the ending of the file."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np
from PIL import Image

from buggy_rl.core.extras import needs
from buggy_rl.core.files import replacing
from buggy_rl.visual.film.shot import Frame

QUALITY = 21  # H.264's constant rate factor; 18 is visually lossless, 23 the encoder's default
COLOURS = 128  # of a gif's one palette
SAMPLED = 12  # frames that it is made for


def write_video(frames: Iterable[Frame], file: str | Path, fps: float) -> int:
    """Writes frames [H, W, 3] to a file and returns their number; a png holds the last one.

    Raises:
        ValueError: The ending is none of `WRITERS`, or there is no frame.
    """
    file = Path(file)
    check_ending(file)
    count = 0

    def counted() -> Iterator[Frame]:
        nonlocal count
        for frame in frames:
            count += 1
            yield np.ascontiguousarray(frame)

    with replacing(file) as partial:
        WRITERS[file.suffix.lower()](counted(), partial, fps)
    return count


def check_ending(file: str | Path) -> None:
    """Refuses what cannot be written, before anything is computed.

    Raises:
        ValueError: The ending is none of `WRITERS`.
    """
    ending = Path(file).suffix.lower()
    if ending not in WRITERS:
        raise ValueError(f"output={file}: the ending must be one of {', '.join(WRITERS)}")


def _mp4(frames: Iterator[Frame], file: Path, fps: float) -> None:
    needs("imageio_ffmpeg", "visual", f"writing {file}")
    from imageio_ffmpeg import write_frames

    first = _first(frames)
    height, width, _ = first.shape
    options = ["-f", "mp4", "-crf", str(QUALITY), "-preset", "veryfast", "-movflags", "faststart"]
    arguments: dict[str, Any] = {  # its annotations are narrower than what it takes
        "fps": fps,
        "codec": "libx264",
        "pix_fmt_out": "yuv420p",  # what browsers and phones play
        "quality": None,
        "macro_block_size": 2,
        "output_params": options,
    }
    writer = write_frames(str(file), (width, height), **arguments)
    writer.send(None)
    try:
        writer.send(first)
        for frame in frames:
            writer.send(frame)
    finally:
        writer.close()


def _gif(frames: Iterator[Frame], file: Path, fps: float) -> None:
    first = _first(frames)
    still = Image.Dither.NONE  # dots that dance from frame to frame are worse than a step
    with TemporaryFile() as raw:  # the palette is that of the whole film
        raw.write(first.tobytes())
        for frame in frames:
            raw.write(frame.tobytes())
        kept = np.memmap(raw, np.uint8, "r").reshape(-1, *first.shape)
        palette = _palette(kept)
        images = (Image.fromarray(f).quantize(palette=palette, dither=still) for f in kept)
        hundredths = max(2, round(100 / fps))  # it counts in 10 ms; browsers slow down below 20 ms
        next(images).save(file, "GIF", save_all=True, append_images=images, optimize=False,
                          duration=10 * hundredths, loop=0)  # fmt: skip


def _palette(frames: np.ndarray) -> Image.Image:
    """An image whose palette has the colours of frames [N, H, W, 3] spread over the film."""
    chosen = np.linspace(0, len(frames) - 1, min(SAMPLED, len(frames))).round().astype(int)
    spread = Image.fromarray(np.concatenate(frames[chosen]))
    return spread.quantize(COLOURS, Image.Quantize.MEDIANCUT)


def _png(frames: Iterator[Frame], file: Path, fps: float) -> None:
    del fps
    last = _first(frames)
    for last in frames:  # noqa: B007
        pass
    Image.fromarray(last).save(file, "PNG", optimize=True)


def _first(frames: Iterator[Frame]) -> Frame:
    for frame in frames:
        return frame
    raise ValueError("there is no frame to write")


WRITERS: dict[str, Callable[[Iterator[Frame], Path, float], None]] = {
    ".mp4": _mp4,
    ".gif": _gif,
    ".png": _png,
}
"""Ending of a file -> what writes it."""
