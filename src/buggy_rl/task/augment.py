"""A simulator with other parameters and further effects, one set of values an environment."""

from collections.abc import Mapping, Sequence
from typing import Any

from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import Compose, EnvBase, TransformedEnv

from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.effects import make_effect, position
from buggy_rl.effects.base import Effect

Values = Mapping[str, Mapping[str, Tensor]]
"""Effect -> parameter -> values."""
Options = Mapping[str, Mapping[str, Any]]
"""Effect -> option -> value, as `effects.measuring` finds them."""


def augmented(
    simulator: EnvBase,
    effects: Values,
    parameters: Mapping[str, Tensor],
    standing: Sequence[Effect] = (),
    options: Options | None = None,
) -> tuple[TransformedEnv, list[Effect]]:
    """Puts parameters and effects into a simulator; also returns all effects that it then has.

    Effects that the simulator has already stay, and all stand in their canonical order: what acts
    on the motion nearer to the engine than what senses it.

    Args:
        simulator: With batch size [B]; not changed.
        effects: Values [B] of each effect's parameters.
        parameters: The simulator's own, name -> [B].
        standing: Further effects, with one value for all environments.
        options: Of `effects`, by name.

    Raises:
        ValueError: The simulator has one of the effects already, or transforms that are none.
    """
    # `with_parameters` of the whole would be the engine's: its effects would be gone.
    engine = simulator.base_env if isinstance(simulator, TransformedEnv) else simulator
    present = [effect.clone() for effect in (*effects_of(simulator), *standing)]
    if parameters:
        values = TensorDict(dict(parameters), engine.batch_size, device=engine.device)
        engine = engine.with_parameters(values)  # type: ignore[operator]
    period = {"dt": getattr(engine, "dt", CONTROL_PERIOD)}
    added = [
        make_effect(name, (options or {}).get(name), **period).with_parameters(
            TensorDict(dict(values), engine.batch_size)
        )
        for name, values in effects.items()
    ]
    twice = sorted({e.name for e in present} & {e.name for e in added})
    if twice:
        raise ValueError(f"the simulator has {', '.join(twice)} already: look for other effects")
    stack = sorted([*present, *added], key=lambda effect: position(effect.name, effect.kind))
    env = TransformedEnv(engine, Compose([]), auto_unwrap=True)
    for effect in stack:
        env.append_transform(effect)
    return env, stack


def effects_of(simulator: EnvBase) -> list[Effect]:
    """Effects that a simulator has from the start, from its engine outwards.

    Raises:
        ValueError: It has transforms that are no effects.
    """
    if not isinstance(simulator, TransformedEnv):
        return []
    outer = simulator.transform
    found = list(outer) if isinstance(outer, Compose) else [outer]
    others = [type(t).__name__ for t in found if not isinstance(t, Effect)]
    if others:
        raise ValueError(
            f"a simulator may have effects over its engine, not {', '.join(others)}: those are a "
            "task's"
        )
    return found  # type: ignore[return-value]
