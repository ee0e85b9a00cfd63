"""Every PyTorch engine computes where it is told to."""

import pytest
import torch
from torch.testing import assert_close
from torchrl.data import Unbounded

from buggy_rl.engines import ENGINES, base, make_engine
from buggy_rl.engines.reference import engine as reference
from buggy_rl.models import MODELS
from buggy_rl.models.factory import ModelConfig, make_model

PYTORCH = [
    *(name for name in ENGINES if name not in ("mujoco", "learned")),
    *(f"learned {model}" for model in MODELS),
]


def make(name: str, device: str):
    engine, _, kind = name.partition(" ")
    torch.manual_seed(0)
    options = {"model": make_model(ModelConfig(kind))} if kind else {}
    return make_engine(engine, 4, device, **options)


def step(engine):
    state = engine._reset(None)
    state["action"] = torch.full((4, 2), 0.3, device=engine.device)
    return engine._step(state)


def test_the_meta_device_refuses_tensors_of_another_device():
    with pytest.raises(RuntimeError):
        torch.ones(3, device="meta") + torch.ones(3)


@pytest.mark.parametrize("name", PYTORCH)
def test_no_step_mixes_devices(name: str, monkeypatch: pytest.MonkeyPatch):
    # Meta tensors have a device but no content: what runs on them runs on a GPU as well. Only
    # checks of content must be taken out: of TorchRL's bounds, and of our own parameters.
    monkeypatch.setattr(
        base, "Bounded", lambda _low, _high, shape, device: Unbounded(shape, device=device)
    )
    monkeypatch.setattr(reference, "refuse_of_another_command", lambda *_: None)
    monkeypatch.setattr(torch.Tensor, "__bool__", lambda _: True)
    result = step(make(name, "meta"))
    assert {str(value.device) for value in result.values()} == {"meta"}


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
@pytest.mark.parametrize("name", PYTORCH)
def test_a_gpu_gives_the_same_step_as_the_cpu(name: str):
    on_cpu, on_gpu = step(make(name, "cpu")), step(make(name, "cuda"))
    for key, value in on_cpu.items():
        assert_close(on_gpu[key].cpu(), value, atol=1e-4, rtol=1e-3)
