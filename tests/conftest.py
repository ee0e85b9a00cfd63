"""Fixtures for all tests; one torch thread, because two default ones collapse beside any other."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from buggy_rl.kernels.kernel import FOLDER

torch.set_num_threads(1)
os.environ[FOLDER] = ""  # PyTorch alone, whatever is compiled here: the same to the last bit


# Minutes by few tests: begun last it would leave one core alone with it at the end.
LONGEST = "tests/blind_test/test_proof.py"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest file first; the Makefile keeps pytest-xdist from sorting files by their tests."""
    items.sort(key=lambda item: not item.path.as_posix().endswith(LONGEST))


@pytest.fixture(scope="module")
def compiled() -> Iterator[None]:
    """The kernels of `make install`, as users have them, also in processes that the tests start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(FOLDER)
        yield


@pytest.fixture(scope="session")
def dart_folder() -> Path:
    """The real DART drives: where `BUGGY_RL_DART` says, or beside the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data" / "dart"
    folder = Path(os.environ.get("BUGGY_RL_DART", beside))
    if not folder.is_dir():
        pytest.skip("the DART drives are not here: name their folder in BUGGY_RL_DART")
    return folder


@pytest.fixture(scope="session")
def frictionmaps_folder() -> Path:
    """The FrictionMaps drives: where `BUGGY_RL_FRICTIONMAPS` says, or beside the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data" / "frictionmaps"
    folder = Path(os.environ.get("BUGGY_RL_FRICTIONMAPS", beside))
    if not folder.is_dir():
        pytest.skip("no FrictionMaps drives here: name their folder in BUGGY_RL_FRICTIONMAPS")
    return folder


@pytest.fixture(scope="session")
def repository() -> Path:
    """The root of the repository."""
    return Path(__file__).resolve().parents[1]
