"""From the bytes of a file to text: its encoding, by byte order mark and by trial."""

import codecs
import re

from buggy_rl.recordings.errors import RecordingError

MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),  # begins with that of UTF-16, so it is tried before
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
"""Byte order mark -> encoding."""
TRIED = ("utf-8", "cp1252", "latin-1")
"""Encodings without a mark, in order; Latin-1 decodes any bytes."""
SAMPLE = 4096  # [bytes] looked at for UTF-16 without a mark
HALF_ZERO = 0.7  # share of zero bytes at even or odd places that UTF-16 of plain text has; chosen
# Tab, line ends, form feed, the end of file of DOS, and zero bytes, which are told line by line.
BINARY = re.compile(r"[\x01-\x08\x0b\x0e-\x19\x1b-\x1f]")


def decoded(content: bytes, file: str) -> str:
    """The text of a file in UTF-8, UTF-16, UTF-32, Windows-1252 or Latin-1.

    Raises:
        RecordingError: It is not text.
    """
    for encoding in _encodings(content):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if BINARY.search(text):
            break
        return text.rstrip("\x1a")
    message = "not text in UTF-8, UTF-16 or Latin-1; save it as UTF-8 text"
    raise RecordingError(file, message)


def _encodings(content: bytes) -> tuple[str, ...]:
    for mark, encoding in MARKS:
        if content.startswith(mark):
            return (encoding,)
    sample = content[:SAMPLE]
    even, odd = (part.count(0) / max(len(part), 1) for part in (sample[0::2], sample[1::2]))
    if odd > HALF_ZERO > even:
        return ("utf-16-le",)
    if even > HALF_ZERO > odd:
        return ("utf-16-be",)
    return TRIED
