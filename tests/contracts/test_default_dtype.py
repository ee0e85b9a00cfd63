"""What is shared stays in single precision where PyTorch's default is double."""

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.simulators import ENGINES
from tests.contracts.test_engines import make
from tests.contracts.test_transforms import stacked

DOUBLE = {"physics_state", "actuators"}  # of MuJoCo


@pytest.fixture(autouse=True)
def double_by_default():
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


def environments():
    """Every engine, and a whole task."""
    return [*sorted(ENGINES), "everything"]


@pytest.mark.parametrize("name", environments())
def test_no_number_becomes_double_in_any_engine_or_task(name):
    env = stacked(name, "mujoco", (3,)) if name == "everything" else make(name, (3,))
    check_env_specs(env)
    rows = env.rollout(8, break_when_any_done=False)
    for part in (rows, rows["next"]):
        odd = {k for k, v in part.items() if getattr(v, "dtype", None) == torch.float64}
        assert odd <= DOUBLE
    state = env.reset().set(keys.ACTION, torch.zeros(3, 2))  # an action in double precision
    assert env.step(state)["next", keys.VELOCITY].dtype == torch.float32
