"""Turns recordings of a small car into simulators of it, policies, and the physics left out.

Names are imported when they are first used, so that `import buggy_rl` costs no torch; docs/api.md
shows each.
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from buggy_rl.api.diagnosis import Diagnosis as Diagnosis
    from buggy_rl.api.diagnosis import diagnose as diagnose
    from buggy_rl.api.fitting import FittedSimulator as FittedSimulator
    from buggy_rl.api.fitting import evaluate as evaluate
    from buggy_rl.api.fitting import fit as fit
    from buggy_rl.api.training import train_model as train_model
    from buggy_rl.api.training import train_policy as train_policy
    from buggy_rl.core.parameters import Parameter as Parameter
    from buggy_rl.effects import make_effect as make_effect
    from buggy_rl.effects.base import Effect as Effect
    from buggy_rl.policies.training.actor_critic import load_policy as load_policy
    from buggy_rl.recordings import ColumnMap as ColumnMap
    from buggy_rl.recordings import Recording as Recording
    from buggy_rl.recordings import RecordingError as RecordingError
    from buggy_rl.recordings import load_recordings as load_recordings
    from buggy_rl.recordings import save_recording as save_recording
    from buggy_rl.simulators import from_gymnasium as from_gymnasium
    from buggy_rl.simulators import from_mjcf as from_mjcf
    from buggy_rl.simulators import from_step as from_step
    from buggy_rl.simulators import make_engine as make_engine
    from buggy_rl.simulators.base import Engine as Engine
    from buggy_rl.simulators.learned.factory import load_model as load_model
    from buggy_rl.task.env import TaskConfig as TaskConfig
    from buggy_rl.task.env import make_env as make_env
    from buggy_rl.task.env import make_simulator as make_simulator
    from buggy_rl.task.env import with_effects as with_effects

__version__ = "0.1.0"

_PLACES = {  # name -> module that has it
    "ColumnMap": "recordings",
    "Diagnosis": "api.diagnosis",
    "Effect": "effects.base",
    "Engine": "simulators.base",
    "FittedSimulator": "api.fitting",
    "Parameter": "core.parameters",
    "Recording": "recordings",
    "RecordingError": "recordings",
    "TaskConfig": "task.env",
    "diagnose": "api.diagnosis",
    "evaluate": "api.fitting",
    "fit": "api.fitting",
    "from_gymnasium": "simulators",
    "from_mjcf": "simulators",
    "from_step": "simulators",
    "load_model": "simulators.learned.factory",
    "load_policy": "policies.training.actor_critic",
    "load_recordings": "recordings",
    "make_effect": "effects",
    "make_engine": "simulators",
    "make_env": "task.env",
    "make_simulator": "task.env",
    "save_recording": "recordings",
    "train_model": "api.training",
    "train_policy": "api.training",
    "with_effects": "task.env",
}

__all__ = ["__version__", *_PLACES]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    globals()[name] = found
    return found


def __dir__():  # without `list[str]`, which the car's Python 3.6 evaluates and refuses
    return sorted({*globals(), *_PLACES})


class _Registration:
    """Registers the environment when Gymnasium is imported; importing it here would cost 0.1 s."""

    def find_spec(self, name, path=None, target=None):
        if name != "gymnasium":
            return None
        others = (f.find_spec(name, path, target) for f in sys.meta_path if f is not self)
        spec = next(filter(None, others), None)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module):
                execute(module)
                _register()

            spec.loader.exec_module = execute_and_register
        return spec


def _register():
    import_module(__name__ + ".task.registration").register()


if "gymnasium" in sys.modules:
    _register()
else:
    sys.meta_path.insert(0, _Registration())
