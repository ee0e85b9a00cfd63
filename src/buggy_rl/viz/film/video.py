"""Writes frames as .mp4, .gif or .png."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import imageio.v2 as imageio
from numpy.typing import NDArray
from PIL import Image

ENDINGS = (".mp4", ".gif", ".png")
COLOURS = 128  # of a gif: half the size of 256, and no difference to be seen
SAMPLES = 12  # frames that they are chosen from


class Sink(Protocol):
    """Takes frames one by one."""

    def __call__(self, frame: NDArray) -> None:
        """Of a frame [H, W, 3] uint8."""
        ...


def check_output(file: str | Path) -> Path:
    """The file, if it has an ending that can be written.

    Raises:
        ValueError: It has not.
    """
    file = Path(file)
    if file.suffix.lower() not in ENDINGS:
        raise ValueError(f"output={file}: must end in {', '.join(ENDINGS)}")
    return file


@contextmanager
def writing(file: str | Path, fps: float) -> Iterator[Sink]:
    """Opens a film; what it yields is called with each frame [H, W, 3] uint8.

    A .png keeps the last frame alone. The file is there only when all frames are.

    Raises:
        ValueError: The ending is none of .mp4, .gif, .png.
    """
    file = check_output(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    partial = file.with_name(f".{file.name}.partial{file.suffix}")
    try:
        with _sink(partial, fps) as sink:
            yield sink
        partial.replace(file)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def _sink(file: Path, fps: float) -> Iterator[Sink]:
    kind = file.suffix.lower()
    if kind == ".mp4":
        options: dict[str, Any] = {"fps": fps, "codec": "libx264", "quality": 7}
        with imageio.get_writer(file, macro_block_size=2, **options) as writer:
            yield writer.append_data  # type: ignore[attr-defined]
        return
    frames: list[Image.Image] = []
    yield lambda frame: _keep(frames, Image.fromarray(frame), kind == ".gif")
    if not frames:
        raise ValueError(f"{file}: there is no frame to write")
    if kind == ".png":
        frames[0].save(file)
        return
    palette = _palette(frames)
    shown = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in frames]
    rest = {"append_images": shown[1:], "duration": round(1000 / fps), "loop": 0}
    shown[0].save(file, save_all=True, optimize=False, **rest)


def _keep(frames: list[Image.Image], image: Image.Image, all_: bool) -> None:
    if not all_:
        frames.clear()
    frames.append(image)


def _palette(frames: list[Image.Image]) -> Image.Image:
    """One palette for all frames, so that what stands still does not flicker."""
    chosen = frames[:: max(1, len(frames) // SAMPLES)] + frames[-1:]
    width, height = frames[0].size
    sheet = Image.new("RGB", (width, height * len(chosen)))
    for index, image in enumerate(chosen):
        sheet.paste(image, (0, index * height))
    return sheet.quantize(COLOURS, dither=Image.Dither.NONE)
