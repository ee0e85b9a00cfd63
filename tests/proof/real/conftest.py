"""Recordings of a car whose motion is known, in the place of those of a real one."""

from pathlib import Path

import pytest

from buggy_rl.proof.real.dataset import Dataset, DatasetConfig, load_dataset
from buggy_rl.recordings import save_recording
from tests.proof.real.plant import commands, recording

DRIVES = 4


@pytest.fixture(scope="session")
def drives(tmp_path_factory) -> Path:
    """Folder of drives of two kinds, two each."""
    folder = tmp_path_factory.mktemp("drives")
    for number in range(DRIVES):
        kind = folder / ("slow", "fast")[number % 2]
        kind.mkdir(exist_ok=True)
        drive = recording(commands(900, seed=number), f"drive_{number}")
        save_recording(drive, kind / f"drive_{number}.csv")
    return folder


@pytest.fixture(scope="session")
def config(drives) -> DatasetConfig:
    """Config of the dataset of these drives."""
    return DatasetConfig([str(drives)], car="buggy")


@pytest.fixture(scope="session")
def dataset(config) -> Dataset:
    """The drives as a dataset."""
    return load_dataset("small", config)
