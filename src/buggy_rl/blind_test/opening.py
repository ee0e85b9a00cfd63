"""How often sealed answers were opened: each time is one more chance to tune to them."""

import json
from pathlib import Path

from buggy_rl.blind_test.exam import write_json


def openings(file: Path) -> int:
    """How often so far."""
    return json.loads(file.read_text())["opened"] if file.exists() else 0


def open_once(file: Path) -> int:
    """Counts one more; how often that is."""
    count = openings(file) + 1
    write_json(file, {"opened": count})
    return count
