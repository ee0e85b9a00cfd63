"""The study: drawn cars, where policies for them are trained, and where everything lies.

OUTPUT/secret.sha256             hash of what the cars are drawn from; SEALED/secret.txt itself
OUTPUT/cars/CAR/earlier/         drives before the change, that the simulator is fitted to
OUTPUT/cars/CAR/baseline/        two further minutes before the change
OUTPUT/cars/CAR/recordings/      two minutes after the change
OUTPUT/cars/CAR/fit/, refit/     the fits before and after the change
OUTPUT/cars/CAR/before/          the model of the earlier drives; learned/ that of all drives
OUTPUT/cars/CAR/diagnosis/       repaired.yaml, diagnosis.json
OUTPUT/cars/CAR/simulators/      ARM.yaml, ARM.py: what policies are trained in
OUTPUT/cars/CAR/policies/ARM_N/  a policy
OUTPUT/cars/CAR/driven/          ARM.json, drives in the own simulator; car.json, on the car
OUTPUT/drives.csv, cars.csv      all drives, all cars; transfer.md and transfer.png are made of them
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from omegaconf import MISSING

from buggy_rl.jobs.launching import Launching
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import CaseStore
from buggy_rl.proof.cases.simulators import LEARNED
from buggy_rl.proof.transfer.arms import ARMS
from buggy_rl.proof.transfer.draw import drawn_cars

STAGES = ("drive", "fit", "learn", "diagnose", "train", "evaluate", "page")


@dataclass(frozen=True)
class TransferConfig(Launching):
    """Policies for drawn cars, by arms, driven on the cars."""

    output: str = MISSING
    """Folder of everything."""
    sealed: str = ""
    """Folder of the secret that cars are drawn from; empty for OUTPUT_sealed."""
    cars: int = 20
    """Number of cars; more leave those before them as they are."""
    control_every: int = 10
    """Every so many cars one has nothing wrong, as the control."""
    spread: float = 0.1
    """Share by which each parameter of a car is drawn off its own, at most."""
    arms: list[str] = field(default_factory=lambda: list(ARMS))
    """Simulators that policies are trained in, of `ARMS` in proof/transfer/arms.py."""
    seeds: list[int] = field(default_factory=lambda: list(range(10)))
    """One policy for each."""
    drives: int = 4
    """Drives after the change, and as many before it as the diagnosis's baseline."""
    earlier: int = 6
    """Drives before the change that the simulator is fitted to, less the first two, which stop
    and judge trainings of models."""
    seconds: float = 30.0
    """Length of each [s]."""
    fit: list[str] = field(default_factory=lambda: ["fit_simulator=single_track"])
    """Options of scripts/fit_mujoco.py, of fits before and after the change."""
    model: list[str] = field(default_factory=lambda: list(LEARNED))
    """Options of scripts/train_models.py: the model, which must be called `model`."""
    diagnosis: list[str] = field(default_factory=list)
    """Options of scripts/diagnose.py."""
    policy: list[str] = field(
        default_factory=lambda: ["configs/shac.yaml", "configs/ppo_car.yaml", "validations=3"]
    )
    """YAML files and options of scripts/train_policy.py, the same for every policy."""
    continued: list[str] = field(default_factory=lambda: ["configs/shac_continued.yaml"])
    """The same of policies that begin with another one, after `policy`."""
    steps: int = 240_000
    """Steps of a training; one that begins with another policy has a tenth."""
    judged_seconds: float = 60.0
    """Length of a drive on lap and infinity [s]; on the tight path it is 5 s."""
    judged_drives: int = 2
    """Drives of each policy on each path, which differ by the camera's noise."""
    stages: list[str] = field(default_factory=lambda: list(STAGES))
    """Any of drive, fit, learn, diagnose, train, evaluate, page; what is done is not done again."""
    only: list[int] = field(default_factory=list)
    """Numbers of the cars that train and evaluate are for, so that a study is done in parts; empty
    for all. The tables keep the rows of the others, whose policies need not be there any more."""
    workers: int = 2
    """Things at a time, a core each."""

    def __post_init__(self) -> None:
        for what, names, known in (("stages", self.stages, STAGES), ("arms", self.arms, ARMS)):
            unknown = sorted(set(names) - set(known))
            if unknown:
                raise ValueError(f"no {what} {unknown}; available: {', '.join(known)}")
        for what, least in (("cars", 1), ("control_every", 2), ("drives", 2), ("earlier", 3)):
            if getattr(self, what) < least:
                raise ValueError(f"{what} is {getattr(self, what)}: must be {least} at least")
        if unknown := sorted({*self.only} - {*range(1, self.cars + 1)}):
            raise ValueError(f"only has {unknown}: cars have numbers from 1 to {self.cars}")
        alone = [arm for arm in self.arms if ARMS[arm].start not in ("", *self.arms)]
        if alone:
            raise ValueError(f"arms {alone} begin with policies of {ARMS[alone[0]].start}: name it")

    def needs(self, *made: str) -> bool:
        """Whether an arm is made from one of these: its base or its gradients."""
        chosen = [ARMS[name] for name in self.arms]
        return any(name in (arm.base, arm.gradient) for arm in chosen for name in made)

    @property
    def store(self) -> CaseStore:
        """Place of the secret and its hash."""
        output = Path(self.output)
        return CaseStore(output, Path(self.sealed) if self.sealed else Path(f"{output}_sealed"))

    def drawn(self, secret: str) -> dict[str, Case]:
        """The cars by name."""
        return drawn_cars(
            self.cars, secret, self.control_every, self.spread, self.drives, self.seconds
        )

    @property
    def names(self) -> list[str]:
        """Names of the cars."""
        return [f"{number:02d}" for number in range(1, self.cars + 1)]

    @property
    def trained_cars(self) -> list[str]:
        """Names of the cars that policies are trained for and driven on."""
        return [name for name in self.names if not self.only or int(name) in self.only]

    def car(self, name: str) -> Path:
        """Folder of a car."""
        return Path(self.output) / "cars" / name

    def fitted(self, car: str, folder: str = "fit") -> Path:
        """File of a car's fit before the change, or of that in another folder of the car."""
        options = dict(option.split("=", 1) for option in self.fit if "=" in option)
        return self.car(car) / folder / f"{options.get('fit_simulator', 'mujoco')}_fitted.yaml"

    def model_of(self, car: str, folder: str) -> Path:
        """File of a car's model, `before` or `learned`."""
        return self.car(car) / folder / "models" / "model.pt"

    def repaired(self, car: str) -> Path:
        """File of a car's repaired simulator."""
        return self.car(car) / "diagnosis" / "repaired.yaml"

    def answer(self, car: str) -> Path:
        """File of what a car's diagnosis says."""
        return self.car(car) / "diagnosis" / "diagnosis.json"

    def simulator_of(self, arm: str, car: str) -> str:
        """What an arm's policies are trained in."""
        file = self.car(car) / "simulators" / arm
        return f"{file}.py:make" if ARMS[arm].drawn else f"{file}.yaml"

    def policies(self) -> list["Trained"]:
        """Every policy that is trained, by car."""
        return [Trained(a, c, s) for c in self.trained_cars for a in self.arms for s in self.seeds]

    def folder(self, policy: "Trained") -> Path:
        """Folder of a policy."""
        return self.car(policy.car) / "policies" / f"{policy.arm}_{policy.seed}"

    def steps_of(self, arm: str) -> int:
        """Steps of an arm's trainings."""
        return self.steps // 10 if ARMS[arm].start else self.steps

    def driven(self, car: str, arm: str = "car") -> Path:
        """File of an arm's drives in its own simulator, or of all drives on a car."""
        return self.car(car) / "driven" / f"{arm}.json"


class Trained(NamedTuple):
    """One policy: where it was trained, for which car, and its seed."""

    arm: str
    car: str
    seed: int
