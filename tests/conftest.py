"""Fixtures for all tests; one torch thread, because two default ones collapse beside any other."""

import gc
import math
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from buggy_rl.core.kernels import CACHE, FOLDER
from buggy_rl.diagnosis.repair import layers

torch.set_num_threads(1)
# Objects of imported packages are many, and garbage collection would visit them again and again.
gc.set_threshold(200_000, 20, 100)
# Named, so that no command of a test compiles what `make install` has not.
os.environ.setdefault(FOLDER, str(CACHE))


def pytest_collection_finish() -> None:
    """Leaves what was imported and collected out of garbage collection."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module")
def without_kernels() -> Iterator[None]:
    """PyTorch alone, also in processes that the tests start: for what holds to the last bit.

    All other tests run the kernels that `make install` compiled, as users do. It is of a whole
    module, whose own fixtures are made without as well; fixtures of the session, which other
    modules read too, may not simulate there.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(FOLDER, "")
        yield


@pytest.fixture(scope="module")
def without_gradients() -> Iterator[None]:
    """Of a whole module, whose own fixtures are made without as well.

    Kernels run where gradients are not recorded, and most drives of a test need none. A kernel is
    made of the very source that is tested: of a source that was changed since there is none, and
    PyTorch runs its lines.
    """
    with torch.no_grad():
        yield


ENDED = "buggy_rl.diagnosis.repair.layers.ENDED"
TRIED_FROM = layers.ENDED


@pytest.fixture(scope="session", autouse=True)
def _nothing_upon_what_is_named() -> Iterator[None]:
    """No layers: each diagnosis of a test would take twice as long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ENDED, math.inf)
        yield


@pytest.fixture(scope="module")
def with_layers(_nothing_upon_what_is_named: None) -> Iterator[None]:
    """Layers upon what is named, as users get them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ENDED, TRIED_FROM)
        yield


@pytest.fixture(scope="session")
def canned_folder(pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where `canned` keeps diagnoses: one folder for all processes of the tests."""
    if hasattr(pytestconfig, "cache"):  # unless pytest is told to keep nothing
        return pytestconfig.cache.mkdir("diagnoses")  # pyright: ignore[reportAttributeAccessIssue]
    base = tmp_path_factory.getbasetemp()
    if hasattr(pytestconfig, "workerinput"):  # pytest-xdist: a folder of each process in one of all
        base = base.parent
    folder = base / "diagnoses"
    folder.mkdir(exist_ok=True)
    return folder


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
