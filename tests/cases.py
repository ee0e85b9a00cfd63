"""Recordings of reference cars with one concealed effect each.

The sizes are clearly noticeable to a driver and taken from no prior. The concealed effect acts in
the car's own physics or camera, and shares no code with the effects of the diagnosis.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from tensordict import TensorDict

from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.policies.controllers.recording import recorded_steps
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.proof.cases import sizes
from buggy_rl.proof.cases.sizes import CAMERA
from buggy_rl.recordings import Recording
from buggy_rl.recordings.camera import Camera, CameraConfig
from buggy_rl.simulators.reference import ReferenceEngine
from buggy_rl.simulators.reference.faults import NEUTRAL

# effect -> parameter -> range of its size, and whether its sign is drawn too
SIZES, UNKNOWN_SIZES = (
    {effect: {name: size[:3] for name, size in sizes.items()} for effect, sizes in ranges.items()}
    for ranges in (sizes.SIZES, sizes.UNKNOWN_SIZES)
)


@dataclass(frozen=True)
class Case:
    """The effect concealed in one car; none under the name `nothing`."""

    name: str
    parameters: dict[str, float] = field(default_factory=dict)

    @property
    def known(self) -> bool:
        """Whether the effect library contains it."""
        return self.name in SIZES

    def camera(self, quality: CameraConfig) -> CameraConfig:
        """The camera with the concealed effect."""
        errors = CAMERA.get(self.name, {})
        wrong = {errors[name]: v for name, v in self.parameters.items() if name in errors}
        return replace(quality, **wrong)


@dataclass(frozen=True)
class Drives:
    """The recordings of a case."""

    case: Case
    train: list[Recording]
    held_out: list[Recording]


NOTHING = Case("nothing")


def draw(seed: int, names: Sequence[str] = (*SIZES, *UNKNOWN_SIZES)) -> list[Case]:
    """One case for each name, with random sizes; `nothing` has none."""
    ranges = SIZES | UNKNOWN_SIZES | {"nothing": {}}
    generator = torch.Generator().manual_seed(seed)
    cases = []
    for name in names:
        parameters = {}
        for parameter, (low, high, signed) in ranges[name].items():
            share, side = torch.rand(2, generator=generator).tolist()
            size = low + (high - low) * share
            parameters[parameter] = round(-size if signed and side < 0.5 else size, 4)
        cases.append(Case(name, parameters))
    return cases


def concealing(cases: Sequence[Case], cars: int = 1) -> ReferenceEngine:
    """The cars of all cases in one batch, `cars` equal ones of each."""
    count = len(cases) * cars
    faults: dict[str, torch.Tensor] = {}
    for index, case in enumerate(cases):
        for parameter, value in case.parameters.items():
            name = f"{case.name}.{parameter}"
            if name in NEUTRAL:
                rows = faults.setdefault(name, torch.full((count,), NEUTRAL[name]))
                rows[index * cars : (index + 1) * cars] = value
    return ReferenceEngine(count).with_faults(TensorDict(faults, [count]))


@torch.no_grad()
def make_drives(
    cases: Sequence[Case],
    seed: int = 0,
    seconds: float = 45.0,
    train: int = 2,
    held_out: int = 1,
    quality: CameraConfig | None = None,
) -> list[Drives]:
    """Drives every case in a room, in one batch, and measures it; deterministic under the seed."""
    cars = train + held_out
    engine = concealing(cases, cars)
    rows = list(recorded_steps(engine, RoomDriver(seed=seed), round(seconds / CONTROL_PERIOD)))
    true = TensorDict.stack(rows, 1)  # (N, T)
    result = []
    for index, case in enumerate(cases):
        recordings = []
        for car in range(cars):
            place = index * cars + car
            camera = Camera(case.camera(quality or CameraConfig()), seed * 100_003 + place)
            data = camera.recorded(true[place])
            recordings.append(Recording(f"drive_{place:03d}", data, CONTROL_PERIOD))
        result.append(Drives(case, recordings[:train], recordings[train:]))
    return result
