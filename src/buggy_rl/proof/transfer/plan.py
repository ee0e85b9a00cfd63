"""The study: cars in which something is concealed, and where policies for them are trained.

OUTPUT/cars/CAR/recordings/      two minutes of driving, and baseline/ from before the change
OUTPUT/cars/CAR/diagnosis/       repaired.yaml
OUTPUT/cars/CAR/learned/         the model of the same two minutes
OUTPUT/cars/CAR/policies/ARM_N/  policies for this car; those of no car in OUTPUT/policies
.../policies/ARM.py              the simulator that they train in, where its cars differ
.../policies/ARM.json            their drives in their own simulator
OUTPUT/cars/CAR/driven.json      drives of all policies on the car
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from omegaconf import MISSING

from buggy_rl.jobs.launching import Launching
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.simulators import LEARNED

STAGES = ("drive", "diagnose", "learn", "train", "evaluate", "page")
ARMS = {
    "unrepaired": "MuJoCo as fitted before the change",
    "repaired": "MuJoCo repaired by the diagnosis of two minutes of driving",
    "learned": "a model learned from the same two minutes",
    "randomised": "MuJoCo with randomised physics",
}
DRAWN = ("unrepaired", "repaired", "randomised")  # MuJoCo, whose cars may differ
SHARED = ("unrepaired", "randomised")  # know nothing of the car, so they are trained once a seed
FIRST_SEED = 700_000_000  # of cars: no case of scripts/prove.py has it


@dataclass(frozen=True)
class TransferConfig(Launching):
    """Four policies for each concealed car, driven on it."""

    output: str = MISSING
    """Folder of everything."""
    simulator: str = "runs/sample/mujoco_fitted.yaml"
    """The simulator as it was before the change."""
    cars: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)
    """What is concealed, as cars.CAR.EFFECT.PARAMETER=VALUE; new ones go to the end. A car of {}
    is one with nothing wrong, for control: it is shown, and not counted in means."""
    arms: list[str] = field(default_factory=lambda: list(ARMS))
    """Simulators that policies are trained in: any of unrepaired, repaired, learned, randomised."""
    seeds: list[int] = field(default_factory=lambda: [0, 1, 2])
    """One policy for each."""
    drives: int = 4
    """Drives of the car, and as many before the change; three at least are learned from."""
    seconds: float = 30.0
    """Length of each [s]."""
    seed: int = 0
    """Seed of drivers and cameras."""
    diagnosis: list[str] = field(default_factory=lambda: ["stretches=60"])
    """Options of scripts/diagnose.py; MuJoCo takes its time, so not all stretches of a second."""
    model: list[str] = field(default_factory=lambda: list(LEARNED))
    """Options of scripts/train_models.py: the model, which must be called `model`."""
    undecided: bool = True
    """Whether cars that unrepaired and repaired policies train on differ by what the fit of
    `simulator` left open; else all are its best guess."""
    policy: list[str] = field(default_factory=lambda: ["configs/ppo.yaml", "configs/ppo_car.yaml"])
    """YAML files and options of scripts/train_policy.py, the same for every policy."""
    steps: int = 3_000_000
    """The budget: steps of PPO for each policy."""
    judged_seconds: float = 60.0
    """Length of a drive on lap and infinity [s]; on the tight path it is 5 s."""
    judged_drives: int = 5
    """Drives of each policy on each path, which differ by the camera's noise."""
    stages: list[str] = field(default_factory=lambda: list(STAGES))
    """Any of drive, diagnose, learn, train, evaluate, page; what is done is not done again."""
    workers: int = 2
    """Things at a time, a core each."""

    def __post_init__(self) -> None:
        odd = sorted(name for name in self.cars if not name.isidentifier())
        if odd:
            raise ValueError(f"cars are folders, too: {odd} must be letters, digits, underscores")
        for what, names, known in (("stages", self.stages, STAGES), ("arms", self.arms, ARMS)):
            unknown = sorted(set(names) - set(known))
            if unknown:
                raise ValueError(f"no {what} {unknown}; available: {', '.join(known)}")
        if self.drives < 3:
            raise ValueError(
                f"drives is {self.drives}: must be 3 at least, or the learned model has nothing "
                "left to stop its training by"
            )

    @property
    def cases(self) -> dict[str, Case]:
        """The cars as cases of the proof: reference cars, with drives from before the change."""
        first = FIRST_SEED + 1000 * self.seed
        return {
            name: Case(
                first + place,
                "reference",
                "mujoco_fitted",
                baseline=True,
                concealed=concealed,
                seconds=self.seconds,
                drives=self.drives,
                held_out=0,
            )
            for place, (name, concealed) in enumerate(self.cars.items())
        }

    def car(self, name: str) -> Path:
        """Folder of a car."""
        return Path(self.output) / "cars" / name

    def made_from(self, arm: str, car: str) -> str:
        """File of the one car that an arm's simulator is made from."""
        own = {"repaired": "diagnosis/repaired.yaml", "learned": "learned/models/model.pt"}
        return str(self.car(car) / own[arm]) if arm in own else self.simulator

    def factory(self, arm: str, car: str) -> Path | None:
        """File of the simulator in which an arm's cars differ; None where they are all alike."""
        if arm not in DRAWN or (arm != "randomised" and not self.undecided):
            return None
        return self.folder(Trained(arm, car, 0)).with_name(f"{arm}.py")

    def simulator_of(self, arm: str, car: str) -> str:
        """What an arm's policies are trained in."""
        factory = self.factory(arm, car)
        return self.made_from(arm, car) if factory is None else f"{factory}:make"

    def places(self) -> list[tuple[str, str]]:
        """Every arm, and the car that it is for; those of no car, empty, first."""
        shared = [(arm, "") for arm in self.arms if arm in SHARED]
        return shared + [(a, car) for car in self.cars for a in self.arms if a not in SHARED]

    def policies(self) -> list["Trained"]:
        """Every policy of the study."""
        return [Trained(*place, seed) for place in self.places() for seed in self.seeds]

    def folder(self, policy: "Trained") -> Path:
        """Folder of a policy."""
        above = self.car(policy.car) if policy.car else Path(self.output)
        return above / "policies" / f"{policy.arm}_{policy.seed}"

    def own_drives(self, arm: str, car: str) -> Path:
        """File of an arm's drives in its own simulator."""
        return self.folder(Trained(arm, car, 0)).with_name(f"{arm}.json")

    def car_drives(self, car: str) -> Path:
        """File of all arms' drives on a car."""
        return self.car(car) / "driven.json"


class Trained(NamedTuple):
    """One policy: where it was trained, for which car (empty for all), and its seed."""

    arm: str
    car: str
    seed: int
