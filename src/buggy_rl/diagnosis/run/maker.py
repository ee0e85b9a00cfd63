"""The simulator that is diagnosed: built, stepped finely enough for its drives, measured."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torchrl.envs import EnvBase

from buggy_rl.core.car_file import load_car
from buggy_rl.core.longitudinal import declared_by
from buggy_rl.core.vehicle import CONTROL_PERIOD, Similarity, VehicleDimensions
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.run.case import Drives
from buggy_rl.effects import OF_A_COLUMN, offered
from buggy_rl.effects.measuring import in_turn, measurable_options
from buggy_rl.estimation.body import body_of, bounded_by
from buggy_rl.estimation.evidence import misfit
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments
from buggy_rl.simulators import ENGINES, Factory, read_simulator
from buggy_rl.task.augment import effects_of
from buggy_rl.task.env import make_simulator


@dataclass(frozen=True)
class Maker:
    """Builds a simulator for a number of environments, once for each number."""

    simulator: str | Factory
    """Any engine, .yaml, .pt or file.py:factory, or a factory itself."""
    parameters: Mapping[str, float] | None = None
    """Parameters of the simulator, where they are not as its file says."""
    options: Mapping[str, Any] = field(default_factory=dict)
    _built: dict[int, EnvBase] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(
        cls,
        config: DiagnosisConfig,
        parameters: Mapping[str, float] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> "Maker":
        """Builds the simulator of a question, with further parameters and options."""
        own: dict[str, Any] = {}
        if engine_of(config.simulator) == "mujoco":
            own = {"nthread": config.threads} | in_closed_form(config.simulator)
        own |= {**own_options(config), **(options or {})}
        return cls(config.simulator, parameters, own)

    def __call__(self, count: int) -> EnvBase:
        if count not in self._built:
            self._built[count] = make_simulator(
                self.simulator, count, parameters=self.parameters, **self.options
            )
        return self._built[count]

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs to build it anew."""
        return {**vars(self), "_built": {}}


def own_options(config: DiagnosisConfig) -> dict[str, Any]:
    """Options of an engine of ours that a question says; a user's own factory takes none."""
    engine, own = engine_of(config.simulator), dict[str, Any]()
    if engine in ENGINES or engine.endswith(".pt"):
        own |= {} if config.dt == CONTROL_PERIOD else {"dt": config.dt}
    if config.car and str(config.simulator) in ENGINES:  # a file says itself which car it is
        own["car"] = config.car
    return own


def engine_of(simulator: str | Factory) -> str:
    """The engine of a simulator file; none of a factory."""
    return _engine_and_options(simulator)[0]


def _engine_and_options(simulator: str | Factory) -> tuple[str, dict[str, Any]]:
    """The engine beneath simulator files, and the options that they give it."""
    options: dict[str, Any] = {}
    if callable(simulator):
        return "", options
    while simulator.endswith((".yaml", ".yml")):
        content = read_simulator(Path(simulator))
        simulator, options = str(content["engine"]), {**content["options"], **options}
    return simulator, options


def in_closed_form(simulator: str | Factory) -> dict[str, str]:
    """The option by which a car of MuJoCo's is stepped in closed form; none where it cannot be.

    A file that names a backend is kept to.
    """
    engine, options = _engine_and_options(simulator)
    explicit = options.get("tyres", "explicit") == "explicit"
    own = engine == "mujoco" and explicit and "backend" not in options
    return {"backend": "closed"} if own else {}


CLOSE = 1e-3  # [m] by which a rollout of one second may end elsewhere; chosen
MOST_CLOSE = 0.9  # share of rollouts that have to; others slide, where anything grows


def as_mujoco_steps(make: Maker, segments: Segments) -> tuple[Maker, list[str]]:
    """A maker that steps as MuJoCo does over segments, and in words how near its steps are."""
    if make.options.get("backend") != "closed":
        return make, []
    own = replace(make, options={**make.options, "backend": "cpu"}, _built={})
    ends = [Simulation(each).residuals(segments)[0, :, -1, :2] for each in (make, own)]
    lost = [end.isnan().any(-1) for end in ends]
    apart = (ends[0] - ends[1]).norm(dim=-1).where(~(lost[0] & lost[1]), torch.zeros(()))
    typical = float(apart.nan_to_num(math.inf).quantile(MOST_CLOSE))
    said = f"nine in ten rollouts end within {1000 * typical:.2g} mm of MuJoCo's own"
    if typical > CLOSE:
        return own, [f"MuJoCo's own steps are taken: in closed form {said}"]
    return make, [f"the MuJoCo car is stepped by its equations in closed form: {said}"]


@dataclass(frozen=True)
class IntegrationStep:
    """The integration step with which a simulator is looked at."""

    options: dict[str, Any] = field(default_factory=dict)
    """Options of the simulator, where its step is not the one that it was given with."""
    note: str = ""


@dataclass(frozen=True, eq=False)
class Opened:
    """A simulator, and the library that is compared with it."""

    simulation: Simulation
    """Simulation with what effects must know of the simulator."""
    library: Library
    """What the simulator may lack, or have wrong."""
    notes: list[str]
    step: IntegrationStep = field(default_factory=IntegrationStep)


def open_simulator(
    config: DiagnosisConfig,
    drives: Drives,
    simulation: Callable[[Maker], Simulation] = Simulation,
    begun: float | None = None,
) -> Opened:
    """Builds the simulator of a question with a step that is fine enough, and measures it.

    Args:
        config: The question.
        drives: What it is compared with.
        simulation: Of what a maker builds.
        begun: When the diagnosis began (`time.perf_counter`): measuring has chains of about as many
            steps as have been made since. None where no process is worth starting for one.
    """
    step = _step(config, drives)
    make, said = as_mujoco_steps(Maker.of(config, options=step.options), drives.segments)
    spent = 0.0 if begun is None else time.perf_counter() - begun
    opened = _measured(config, simulation(make), drives, spent)
    return replace(opened, step=step, notes=[*said, *opened.notes])


def _step(config: DiagnosisConfig, drives: Drives) -> IntegrationStep:
    """The step that the simulator needs for drives; a user's own factory takes no options."""
    if engine_of(config.simulator) not in ENGINES:
        return IntegrationStep()
    return fine_enough(
        lambda options: Simulation(Maker.of(config, options=options)),
        drives.segments,
        config.search.finer_step_gain,
    )


HALVINGS = 3  # at most; each takes twice the time


def fine_enough(
    simulation: Callable[[Mapping[str, Any]], Simulation], segments: Segments, least_gain: float
) -> IntegrationStep:
    """Halves a simulator's step as long as that brings it closer to the recordings.

    The error of a coarse step resembles other tyres. Solving the equations with half the step tells
    one from the other: verification comes before validation (Oberkampf & Roy 2010, Verification and
    Validation in Scientific Computing). A simulator that was fitted with a coarse step is right
    with it, and keeps it.

    Args:
        simulation: Of the simulator with further options; with none, as it was given.
        segments: Of the recordings.
        least_gain: By which half the step must come closer [noise].
    """
    own = simulation({})
    finer = _halved(own)
    if not finer:
        return IntegrationStep()
    noise = noise_model(own, segments)
    given = noise.whiten(own.residuals(segments))[0].square().mean(-1)
    first = last = misfit(given, given)
    chosen: dict[str, Any] = {}
    for _ in range(HALVINGS):
        half = simulation(finer)
        off = misfit(noise.whiten(half.residuals(segments))[0].square().mean(-1), given)
        if last - off < least_gain:
            break
        chosen, last, finer = finer, off, _halved(half)
    if not chosen:
        return IntegrationStep()
    named = ", ".join(f"{name}={value:g}" for name, value in chosen.items())
    return IntegrationStep(
        chosen,
        f"the simulator integrates too coarsely for these drives: with {named} in its options it "
        f"is off by {last:.2f} times the noise instead of {first:.2f}; the answer is about that "
        "one, and repaired.yaml has it",
    )


def _halved(simulation: Simulation) -> dict[str, Any]:
    """Options with half the step of a simulator, if it has one."""
    return getattr(simulation.make(1), "half_step", {})


def _measured(
    config: DiagnosisConfig, simulation: Simulation, drives: Drives, seconds: float
) -> Opened:
    """What effects must know of a simulator, and the library that is compared with it.

    Args:
        config: The question.
        simulation: Of the simulator.
        drives: What it is compared with.
        seconds: That a chain of its steps is expected to take; for little, no process is started.
    """
    make, apart = simulation.make, partial(simulation.workers.results, seconds=seconds)
    own = drives.baseline is None if config.parameters is None else config.parameters
    inside = [effect.name for effect in effects_of(make(1))]
    black_box = config.parameters is False
    realises = {} if black_box else getattr(make(1), "realises", {})
    declared = getattr(make(1), "declared", {}) if own or realises else {}
    declared = {name: bounded_by(body_of(make(1)), p) for name, p in declared.items()}
    derived = set.intersection(*(set(r.derived) for r in drives.recordings))
    names = config.effects or offered(declared_by(make(1)), derived)
    scale = _similarity(config, make)
    library = Library([e for e in names if e not in inside], declared, own, realises, scale)
    options, notes = measurable_options(make, apart, *_of_the_file(config))
    left_out = [n for n, column in OF_A_COLUMN.items() if column in derived]
    if left_out and not config.effects:
        notes.append(
            f"{', '.join(sorted(derived))} follow from the pose in all recordings: "
            f"{', '.join(left_out)} cannot be told and are not looked for"
        )
    return Opened(replace(simulation, options=options), library, notes)


def measured_again(
    config: DiagnosisConfig, given: Simulation, make: Callable[[int], Any], library: Library
) -> Opened:
    """A simulator whose own parameters were fitted: what effects must know of it is measured anew.

    Args:
        config: The question.
        given: Of the simulator as it was given.
        make: Builds the re-tuned one.
        library: Of the simulator as it was given.
    """
    options, notes = measurable_options(make, in_turn, *_of_the_file(config))
    declared = getattr(make(1), "declared", {})
    library = Library(library.effects, declared, own=False, similarity=library.similarity)
    return Opened(replace(given, make=make, options=options), library, notes)


def _of_the_file(config: DiagnosisConfig) -> tuple[VehicleDimensions | None, float | None]:
    """Dimensions and largest road-wheel angle [rad] of the car, where a file says them."""
    if not config.car:
        return None, None
    car = load_car(config.car)
    locks = [angle for angle in (car.steering.left, car.steering.right) if angle]
    return car.vehicle, max(locks, default=None)


def _similarity(config: DiagnosisConfig, make: Callable[[int], Any]) -> Similarity:
    """Ratios of the car to the buggy; without a car's file those of the simulator."""
    if config.car:
        return load_car(config.car).similarity
    return getattr(make(1), "similarity", Similarity())
