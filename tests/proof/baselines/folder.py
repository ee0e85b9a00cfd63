"""Folders of what may be seen, with drives of a single-track car."""

from collections.abc import Sequence
from pathlib import Path

import yaml

from buggy_rl.recordings import Recording, save_recording


def shown(
    folder: Path,
    recordings: Sequence[Recording],
    engine: str = "single_track",
    baseline: Sequence[Recording] = (),
    effects: Sequence[str] = (),
) -> Path:
    """Writes a question about `engine`."""
    question = {"simulator": "simulator.yaml", "recordings": ["recordings"]}
    if baseline:
        question["baseline"] = ["baseline"]
    if effects:
        question["effects"] = list(effects)
    for name, drives in (("recordings", recordings), ("baseline", baseline)):
        for drive in drives:
            (folder / name).mkdir(parents=True, exist_ok=True)
            save_recording(drive, folder / name / f"{drive.name}.csv")
    (folder / "question.yaml").write_text(yaml.safe_dump(question))
    (folder / "simulator.yaml").write_text(yaml.safe_dump({"engine": engine}))
    return folder
