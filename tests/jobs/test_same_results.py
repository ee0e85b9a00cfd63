"""What is written does not depend on the launcher or the number of workers: to the last byte."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from buggy_rl.core.files import write_atomically

ROOT = Path(__file__).parents[2]
HOW = {
    "local_1": ("launcher=local", "workers=1"),
    "local_2": ("launcher=local", "workers=2"),
    "ray_2": ("launcher=ray", "workers=2"),
    "submitit_2": ("launcher=submitit", "cluster.cluster=local", "workers=2"),
}
SEEDS = (
    "configs/ppo.yaml", "engine.simulator=single_track", "ppo.steps=4096", "ppo.cars=32",
    "ppo.batch_steps=32", "ppo.minibatch=256", "validations=2", "validation_steps=50",
    "checkpoint_batches=1", "seeds=[0,1,2]",
)  # fmt: skip
PROVE = (
    "draw.each=true", "draw.nothing=1", "draw.cases=2", "draw.seconds=[12.0]",
    "draw.pairings=[reference]", "draw.nuisances=[white]", "draw.driving=[rich]",
    "draw.names=[steering_gain]", "rivals=1", "stages=[prepare,seal,ask,weigh]",
    "effects=[steering_gain,viscous_drag]", "stretches=10",
)  # fmt: skip
DEVELOP = (
    "configs/development.yaml", *PROVE[:7], "draw.families=[one]", "draw.spread=[0.0]",
    "stretches=12", "effects=[steering_gain,viscous_drag]",
)  # fmt: skip
TIMED = ("speed.csv", "seconds_left.csv")


def made(folder: Path, script: str, *options: str) -> Path:
    """Runs a script in a folder of its own, from which it is given relative names alone."""
    folder.mkdir()
    for name in ("configs", "scripts", "data"):
        (folder / name).symlink_to(ROOT / name)
    write_atomically(folder / "out_sealed" / "secret.txt", "the same for all\n")
    command = [sys.executable, f"scripts/{script}", *options, "output=out"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


def contents(folder: Path, *patterns: str) -> dict[str, bytes]:
    """Files of a run by their names."""
    files = [file for pattern in patterns for file in folder.glob(pattern)]
    named = {str(file.relative_to(folder)): file.read_bytes() for file in files}
    return {name: content for name, content in named.items() if not name.endswith(TIMED)}


def same(tmp_path: Path, script: str, options: tuple[str, ...], *patterns: str) -> dict[str, bytes]:
    """Files of a run that are equal for every launcher."""
    found = {
        n: contents(made(tmp_path / n, script, *options, *how), *patterns) for n, how in HOW.items()
    }
    for name, files in found.items():
        assert files == found["local_1"], name
    return found["local_1"]


@pytest.mark.slow
def test_training_seeds(tmp_path):
    files = same(
        tmp_path,
        "train_policy.py",
        SEEDS,
        "out/seed_*/*.pt",
        "out/seed_*/csv/**/*.csv",
        "out/seeds.csv",
    )
    assert len([name for name in files if name.endswith("checkpoint.pt")]) == 3
    assert files["out/seed_0/best.pt"] != files["out/seed_1/best.pt"]


@pytest.mark.slow
@pytest.mark.timeout(2400)
def test_sealed_cases(tmp_path):
    written = ("cases/**/*.csv", "cases/**/*.yaml", "answers/*/diagnosis.json", "hashes.txt")
    patterns = [f"out/{pattern}" for pattern in written]
    files = same(tmp_path, "prove.py", PROVE, *patterns, "out_sealed/weighed/*.json")
    assert len([name for name in files if name.endswith("diagnosis.json")]) == 2
    assert len([name for name in files if "weighed" in name]) == 2


@pytest.mark.slow
@pytest.mark.timeout(2400)
def test_development_cases(tmp_path):
    found = {}
    for name, how in HOW.items():
        folder = made(tmp_path / name, "develop.py", *DEVELOP, *how)
        lines = map(json.loads, (folder / "out" / "development.jsonl").read_text().splitlines())
        ordered = sorted(lines, key=lambda line: line["case"]["seed"])
        found[name] = [json.dumps({**line, "seconds": 0.0}) for line in ordered]
    assert len(found["local_1"]) == 2
    assert all(lines == found["local_1"] for lines in found.values())
