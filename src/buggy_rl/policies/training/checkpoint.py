"""Checkpoint files, and the state of an environment that is not in its TensorDict."""

import hashlib
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.envs import EnvBase, TransformedEnv

from buggy_rl.core.files import load_torch
from buggy_rl.simulators.serial import SinglePrecision


def load_checkpoint(file: Path) -> dict[str, Any]:
    """Reads a checkpoint.

    Raises:
        ValueError: There is no such file.
    """
    if not file.is_file():
        raise ValueError(f"there is no checkpoint {file} to go on from: start without resume=true")
    return load_torch(file)


def environment_state(env: EnvBase) -> dict[str, Any]:
    """Random generators of an environment and all tensors that its transforms keep.

    The cars' own state rides in their TensorDict and is no part of this.
    """
    generators = {name: holder.get_state() for name, holder in _generators(env)}
    tensors = {name: getattr(module, key).clone() for name, module, key in _tensors(env)}
    return {"generators": generators, "tensors": tensors}


def restore_environment(env: EnvBase, state: dict[str, Any]) -> None:
    """Goes back to what `environment_state` saw.

    Raises:
        ValueError: The environment is made of other parts than the one that was saved.
    """
    generators, places = dict(_generators(env)), {n: (m, k) for n, m, k in _tensors(env)}
    refuse_difference(generators, state["generators"])
    refuse_difference(places, state["tensors"])
    for name, generator in generators.items():
        restore_generator(generator, state["generators"][name], name)
    for name, (module, key) in places.items():
        setattr(module, key, state["tensors"][name].clone().to(getattr(module, key).device))


def cars_state(cars: TensorDictBase | None) -> dict[str, Any]:
    """The cars' own state as plain tensors by name; nothing where other processes hold it."""
    return {} if cars is None else cars.detach().clone().flatten_keys(".").to_dict()


def restored_cars(
    env: EnvBase, here: TensorDictBase, saved: dict[str, Any], written: Sequence[Any]
) -> TensorDictBase:
    """The cars as `cars_state` saw them, on the device of the environment.

    Args:
        env: That they are of.
        here: Cars of it.
        saved: What `cars_state` returned.
        written: Keys that a policy writes anew in every step.

    Raises:
        ValueError: They are of another environment.
    """
    cars = TensorDict(saved, env.batch_size).to(env.device or "cpu").exclude(*written)
    cars = cars if env.device else cars.clear_device_()
    refuse_difference(here.flatten_keys(".").exclude(*written).keys(), cars.keys())
    return cars.unflatten_keys(".").clone()


def random_state(device: torch.device | None) -> dict[str, Any]:
    """States of the generators that exploration draws from: PyTorch's, and that of a GPU."""
    of_gpu = torch.cuda.get_rng_state(device or "cuda") if _is_gpu(device) else None
    return {"random": torch.get_rng_state(), "random_device": of_gpu}


def restore_random(device: torch.device | None, state: Mapping[str, Any]) -> None:
    """Goes back to `random_state`: as the last thing, since whatever is built draws from it.

    What was taken on another kind of device is no state of this one's: a warning says so.
    """
    torch.set_rng_state(state["random"].cpu())
    of_gpu = state.get("random_device")
    if _is_gpu(device) != (of_gpu is not None):
        warnings.warn(
            f"the checkpoint was made on another kind of device than {device}: exploration goes on "
            "with other random numbers"
        )
    elif of_gpu is not None:
        torch.cuda.set_rng_state(of_gpu.cpu(), device or "cuda")


def _is_gpu(device: torch.device | None) -> bool:
    return device is not None and device.type == "cuda"


def restore_generator(generator: torch.Generator, state: Tensor, name: str) -> None:
    """Goes back to a generator's state.

    That of another kind of device, which has another layout, seeds it instead, and a warning says
    so: the run then goes on with other random numbers.

    Args:
        generator: On the device of the environment.
        state: [bytes], of `get_state`, on any device.
        name: Of the generator, for the warning.
    """
    state = state.cpu()
    if state.shape == generator.get_state().shape:
        generator.set_state(state)
        return
    digest = hashlib.sha256(state.numpy().tobytes()).digest()
    generator.manual_seed(int.from_bytes(digest[:8], "big", signed=True))
    warnings.warn(
        f"the checkpoint was made on another kind of device than {generator.device}: {name} goes "
        "on with other random numbers"
    )


def refuse_difference(here: Iterable[Any], saved: Iterable[Any]) -> None:
    """Compares names in an environment with those in a checkpoint.

    Raises:
        ValueError: They differ.
    """
    differing = sorted(set(here) ^ set(saved))
    if differing:
        raise ValueError(
            f"the checkpoint was made with another environment: {', '.join(differing)} "
            "is in only one of the two; resume with the config of the first run"
        )


def _generators(env: EnvBase) -> Iterator[tuple[str, torch.Generator]]:
    for name, module in _modules(env):
        for key, value in sorted(vars(module).items()):
            if isinstance(value, torch.Generator):
                yield f"{name}.{key}", value


def _tensors(env: EnvBase) -> Iterator[tuple[str, nn.Module, str]]:
    for name, module in _modules(env):
        if isinstance(module, EnvBase):  # of an engine: its parameters, which are in the config
            continue
        plain = {key for key, value in vars(module).items() if isinstance(value, Tensor)}
        # A buffer that is not persistent is a table made from the config.
        buffers = set(module._buffers) - module._non_persistent_buffers_set
        for key in sorted(plain | buffers):
            if getattr(module, key) is not None:
                yield f"{name}.{key}", module, key


def _modules(env: EnvBase) -> Iterator[tuple[str, nn.Module]]:
    """The environment, what it wraps and every transform between, by name."""
    depth, inner = 0, env
    while isinstance(inner, TransformedEnv):
        for name, module in inner.transform.named_modules():
            yield f"transform{depth}.{name}", module
        depth, inner = depth + 1, inner.base_env
    yield "engine", inner
    if isinstance(inner, SinglePrecision):
        yield "engine.simulator", inner.simulator
