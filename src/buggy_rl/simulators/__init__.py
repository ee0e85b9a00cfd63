"""Engines by name: each moves the car by one kind of physics, all with the same keys."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from buggy_rl.core import trust
from buggy_rl.core.config import load_named

if TYPE_CHECKING:  # at run time a name costs no two seconds of torchrl
    from torchrl.envs import EnvBase

    from buggy_rl.simulators.adapters import from_gymnasium, from_step
    from buggy_rl.simulators.mujoco.mjcf import from_mjcf

__all__ = [
    "ENGINES",
    "as_car",
    "from_gymnasium",
    "from_mjcf",
    "from_step",
    "make_engine",
    "read_simulator",
    "simulator_name",
]

ENGINES = {
    "learned": "buggy_rl.simulators.learned.engine:LearnedEngine",
    "surrogate": "buggy_rl.simulators.surrogate:SurrogateEngine",
    "mujoco": "buggy_rl.simulators.mujoco:MujocoEngine",
    "reference": "buggy_rl.simulators.reference:ReferenceEngine",
    "single_track": "buggy_rl.simulators.bicycle.single_track:SingleTrackEngine",
    "kinematic": "buggy_rl.simulators.bicycle.single_track:KinematicEngine",
    "hold": "buggy_rl.simulators.base:HoldEngine",
}
ADAPTERS = {  # of a user's own simulator; imported when they are asked for
    "from_step": "buggy_rl.simulators.adapters:from_step",
    "from_gymnasium": "buggy_rl.simulators.adapters:from_gymnasium",
    "from_mjcf": "buggy_rl.simulators.mujoco.mjcf:from_mjcf",
}
Factory = Callable[[int, str], "EnvBase"]
"""A user's own simulator as an object: batch size, device -> EnvBase."""


def __getattr__(name: str) -> Any:
    if name in ADAPTERS:
        return load_named(ADAPTERS[name])
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def simulator_name(simulator: str | Path | Factory) -> str:
    """What a simulator is called in messages: as it was given, or an object by its own name."""
    if isinstance(simulator, (str, Path)):
        return str(simulator)
    inner = getattr(simulator, "func", simulator)  # of a partial
    return getattr(inner, "__qualname__", type(inner).__name__)


def make_engine(
    simulator: str | Path | Factory,
    /,
    batch_size: int | Sequence[int] = (),
    device: str = "cpu",
    parameters: Mapping[str, float] | None = None,
    **options: Any,
) -> "EnvBase":
    """Builds a simulator from what a user can write on a command line.

    Args:
        simulator: A name in `ENGINES`; a `.yaml` file with `engine`, `parameters` and `options`;
            a learned model's `.pt` file; or a user's own as `path/to/file.py:factory`,
            `package.module:factory` or the factory itself, with `factory(batch_size, device) ->
            EnvBase`, which is stepped a few times to see that it keeps no state (`contract`).
        batch_size: Number of environments or a shape.
        device: Where the state lives.
        parameters: Physical parameters that differ from the engine's own.
        options: Further arguments of the engine's class; `car`, a car's name or file, stands for
            the arguments and parameters that make the engine that car.

    Raises:
        ValueError: The name is unknown; the message lists the known ones. Or a user's own
            simulator is none, or a step of it depends on more than its TensorDict.
    """
    if callable(simulator):
        return _users_own(simulator, batch_size, device, parameters, options)
    name = str(simulator)
    if options.get("car") and not name.endswith((".yaml", ".yml")):
        made = as_car(name, str(options.pop("car")))
        parameters = {**made["parameters"], **(parameters or {})}
        options = {**made["options"], **options}
    if name.endswith((".yaml", ".yml")):
        return _from_yaml(Path(name), batch_size, device, parameters, options)
    if name.endswith(".pt"):
        return make_engine("learned", batch_size, device, parameters, model=name, **options)
    if ":" in name:
        return _users_own(name, batch_size, device, parameters, options)
    if name not in ENGINES:
        raise ValueError(
            f"no engine {name!r}; available: {', '.join(sorted(ENGINES))}, a .yaml, a .pt, "
            "or your own as file.py:factory"
        )
    try:
        return load_named(ENGINES[name])(batch_size, device, parameters, **options)
    except TypeError as error:  # an option that the class does not have, or one it needs
        raise ValueError(f"engine {name!r}: {error}") from error


def as_car(engine: str, car: str) -> dict[str, dict[str, Any]]:
    """`options` and `parameters` that make an engine the car of a name or file.

    Raises:
        ValueError: There is no such car, or the engine cannot be it.
    """
    from buggy_rl.core.car_file import load_car

    if engine in ("hold", "learned") or engine.endswith(".pt"):  # they know no car
        return {"options": {}, "parameters": {}}
    able = ("single_track", "kinematic", "mujoco", "reference")
    if engine not in able:
        known = ", ".join(able)
        raise ValueError(f"engine {engine!r} cannot be the car {car!r}: {known} can")
    return load_car(car).of_engine(engine)


def _users_own(simulator: str | Factory, batch_size, device, parameters, options) -> Any:
    """A simulator from outside this package, whose steps have been tried out."""
    from buggy_rl.simulators.contract import refuse_stateful

    name = simulator_name(simulator)
    engine = _made(name, simulator, batch_size, device, options)
    if parameters:
        engine = _with_parameters(name, engine, parameters)
    refuse_stateful(engine, name)
    return engine


def _made(name: str, simulator: str | Factory, batch_size, device, options) -> Any:
    """What a user's factory makes: the contract gives it two arguments, no more."""
    ranges = options.pop("ranges", {})
    if options:
        raise ValueError(f"{name}: a factory takes no options, got {sorted(options)}")
    from torchrl.envs import EnvBase

    from buggy_rl.simulators.serial import in_batch, in_single_precision

    factory = load_named(simulator) if isinstance(simulator, str) else simulator
    trust.refuse_other_factory(factory, EnvBase, name)
    try:
        inspect.signature(factory).bind(batch_size, device)
    except TypeError as error:
        raise ValueError(f"{name} is called as factory(batch_size, device): {error}") from error
    made = factory(batch_size, device)
    if not isinstance(made, EnvBase):
        raise ValueError(
            f"{name} returned a {type(made).__module__}.{type(made).__name__}: a factory must "
            "return a TorchRL EnvBase with pose, velocity and action in its TensorDict "
            "(docs/extending.md shows one)"
        )
    engine = in_single_precision(in_batch(made, batch_size))
    if ranges:
        engine.declared = _with_ranges(name, engine, ranges)
    return engine


def _with_parameters(name: str, engine: Any, parameters: Mapping[str, float]) -> Any:
    import torch
    from tensordict import TensorDict

    with_parameters = getattr(engine, "with_parameters", None)
    if not callable(with_parameters):
        raise ValueError(f"{name} takes no parameters (it has no with_parameters)")
    shape = engine.batch_size
    values = {key: torch.full(shape, float(value)) for key, value in parameters.items()}
    return with_parameters(TensorDict(values, shape))


def _with_ranges(name: str, engine: Any, ranges: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    from buggy_rl.simulators.base import with_ranges

    declared = getattr(engine, "declared", {})
    unknown = sorted(set(ranges) - set(declared))
    if unknown:
        known = ", ".join(sorted(declared)) or "none"
        raise ValueError(f"{name}: ranges: no parameter {', '.join(unknown)}; available: {known}")
    return with_ranges(declared, ranges)


def read_simulator(file: Path) -> dict[str, Any]:
    """What a simulator file says: engine, parameters, options, effects; paths made absolute.

    `ranges` of parameters become an option, since engines take them as one.

    Raises:
        ValueError: There is no such file, it is none of a simulator, or it names code that is not
            to be run (`trust`).
    """
    if not file.is_file():
        raise ValueError(f"there is no simulator file {file}")
    content = yaml.safe_load(file.read_text())
    allowed = {"engine", "parameters", "options", "effects", "ranges"}
    if not isinstance(content, dict) or "engine" not in content:
        raise ValueError(f"{file}: a simulator file needs the key 'engine'")
    # Underscored keys hold what a fit reports about itself: intervals, warnings.
    unknown = {key for key in content if not key.startswith("_")} - allowed
    if unknown:
        raise ValueError(f"{file}: unknown keys {sorted(unknown)}; allowed: {sorted(allowed)}")
    result = {key: content.get(key) or {} for key in sorted(allowed)}
    result["engine"] = engine = str(content["engine"])
    if ranges := result.pop("ranges"):
        result["options"] = {**result["options"], "ranges": ranges}
    car = str(result["options"].get("car", ""))
    if car.endswith((".yaml", ".yml")) and (file.parent / car).is_file():
        result["options"] = {**result["options"], "car": str(file.parent / car)}
    result["engine"] = _beside(engine, file)
    if "simulator" in result["options"]:  # of a surrogate gradient
        moves = _beside(str(result["options"]["simulator"]), file)
        trust.refuse_foreign(moves, file)
        result["options"] = {**result["options"], "simulator": moves}
    if "model" in result["options"]:  # a path beside the YAML file itself
        model = str(file.parent / result["options"]["model"])
        result["options"] = {**result["options"], "model": model}
    result["effects"] = {
        name: {**values, "model": str(file.parent / values["model"])}
        if values and "model" in values
        else values
        for name, values in result["effects"].items()
    }
    for name in (result["engine"], *result["effects"]):
        trust.refuse_foreign(str(name), file)
    return result


def _beside(simulator: str, file: Path) -> str:
    """A simulator that a file names: a path is one beside that file."""
    path = simulator.endswith((".yaml", ".yml", ".pt")) or ".py:" in simulator
    return str(file.parent / simulator) if path else simulator


def _from_yaml(file: Path, batch_size, device, parameters, options) -> "EnvBase":
    content = read_simulator(file)
    if content["effects"]:
        raise ValueError(
            f"{file} is an engine with effects: build it with buggy_rl.task.env.make_simulator"
        )
    merged = {**content["parameters"], **(parameters or {})}
    settings = {**content["options"], **options}
    return make_engine(content["engine"], batch_size, device, merged or None, **settings)
