"""Cases from seeds."""

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from buggy_rl.effects import offered
from buggy_rl.proof import plants
from buggy_rl.proof.cases.case import BUGGY, COMMANDS, RATES, Case
from buggy_rl.proof.cases.sizes import (
    CAMERA,
    COMMANDED_SIZES,
    NAMED_SINCE,
    SIZES,
    UNKNOWN_SIZES,
    Uniform,
    composed_sizes,
    scaled_effect,
)
from buggy_rl.proof.plants.composed import SORTS, UNNAMED, WHERE, is_composed
from buggy_rl.proof.plants.reference import abilities_of

FIRST = {"development": 0, "sealed": 1_000_000}  # seeds of a split begin here
PUBLISHED = frozenset(
    {
        *{"aerodynamic_drag", "battery_sag", "cornering_drag", "floor_slope", "grip_balance"},
        *{"grip_patch", "gyro_bias", "motor_power_limit", "one_sided_drag", "payload"},
        *{"rolling_resistance", "sensor_lag", "sensor_latency", "sensor_lever_arm", "sensor_yaw"},
        *{"speed_scale", "steering_asymmetry", "steering_backlash", "steering_dead_time"},
        *{"steering_gain", "steering_lag", "steering_offset", "steering_rate_limit"},
        *{"throttle_dead_time", "throttle_deadband", "throttle_gain", "throttle_lag"},
        *{"throttle_offset", "tire_grip", "top_speed", "viscous_drag", "wind", "yaw_damping"},
        *{"brake_balance", "brake_gain", "drag_brake", "driven_axle_slip", "reverse_deadband"},
        *{"speed_controller_lag", "sticky_servo", "bump_steer", "wheel_wobble"},
        *{"heating_motor", "loose_differential"},
    }
)
"""Effects of the published sets, whose seeds still draw what they drew."""
COUNT = {"nothing": 0, "one": 1, "two": 2, "three": 3}


@dataclass(frozen=True)
class Pairing:
    """What is driven, and what is to be repaired."""

    plant: str
    simulator: str
    baseline: bool
    command: str = "throttle"
    """What the car's first command is, of `case.COMMANDS`."""


PAIRINGS = {
    "reference": Pairing("reference", "reference", False),
    "mujoco": Pairing("mujoco", "mujoco", False),
    "reference_mujoco": Pairing("reference", "mujoco_fitted", True),
    "reference_learned": Pairing("reference", "learned", True),
    "mujoco_single_track": Pairing("mujoco", "single_track_fitted", True),
    "commonroad_mujoco": Pairing("commonroad", "mujoco_fitted", True),
    "commonroad_single_track": Pairing("commonroad", "single_track_fitted", True),
    # Cars with brakes and reverse, or with a speed controller and reverse.
    "reference_brakes": Pairing("reference", "reference", False, "brakes"),
    "reference_speed": Pairing("reference", "reference", False, "speed"),
    # For development: with and without drives from before the change.
    "reference_baseline": Pairing("reference", "reference", True),
    "reference_single_track": Pairing("reference", "single_track_fitted", True),
    "reference_single_track_alone": Pairing("reference", "single_track_fitted", False),
    "reference_mujoco_alone": Pairing("reference", "mujoco_fitted", False),
    "reference_learned_alone": Pairing("reference", "learned", False),
    "mujoco_single_track_alone": Pairing("mujoco", "single_track_fitted", False),
    "commonroad_single_track_alone": Pairing("commonroad", "single_track_fitted", False),
}
# Of simulators whose step can be made coarser from outside.
INTEGRATED = ("reference", "mujoco", "mujoco_fitted")
# That are the plant's own, or fitted in seconds: for them the plant's parameters may be drawn.
REFITTED = ("reference", "mujoco", "single_track_fitted")


@dataclass(frozen=True)
class DrawConfig:
    """What is drawn from; what stands in a list twice is drawn twice as often."""

    split: str = "development"
    """Seeds to calibrate on (development), or to publish (sealed)."""
    first: int = 0
    """First seed of the split."""
    cases: int = 200
    """Number of cases; 0 with `each` for all there are."""
    each: bool = False
    """Every effect once instead of drawn families, then `nothing` cases with none."""
    nothing: int = 20
    """Cases in which nothing is concealed, with `each`."""
    names: list[str] = field(default_factory=list)
    """Effects that may be concealed; empty for all that a plant can."""
    library: str = "published"
    """Effects that are drawn where `names` is empty and not `each`: `published`, those of the
    published sets, or `present`, all; what has got a name since is then not drawn as unknown."""
    families: list[str] = field(
        default_factory=lambda: (
            ["nothing"] * 5 + ["one"] * 9 + ["two"] * 3 + ["three"] + ["unknown"] * 2
        )
    )
    """How many effects are concealed, or one that no entry of the library describes: of six plants'
    own (unknown), or composed at random (composed)."""
    pairings: list[str] = field(
        default_factory=lambda: (
            ["reference"] * 3
            + ["reference_learned", "mujoco_single_track"] * 2
            + ["mujoco", "reference_mujoco", "commonroad_mujoco", "commonroad_single_track"]
        )
    )
    """Pairings that are drawn: in over half of them the simulator is not of the plant's make; in a
    quarter it is MuJoCo, whose diagnosis takes four times as long as others."""
    nuisances: list[str] = field(
        default_factory=lambda: (
            ["white"] * 4
            + ["coloured", "thrice", "stamps", "jitter", "dropped", "integrator"]
            + ["parameters_3", "parameters_10"]
        )
    )
    """What makes it harder beside: see `NUISANCES`."""
    driving: list[str] = field(default_factory=lambda: ["rich"] * 4 + ["steady"])
    """rich, or steady: near-constant driving."""
    seconds: list[float] = field(default_factory=lambda: [45.0] * 3 + [20.0, 90.0])
    """Length of each drive [s]."""
    drives: int = 2
    """Drives to be seen, and as many before the change where there is a baseline."""
    held_out: int = 1
    """Drives that are sealed, to measure by."""
    spread: list[float] = field(default_factory=lambda: [0.0])
    """Shares by which the plant's parameters are drawn off their own; only where its simulator is
    of its make, or quickly fitted anew."""
    rates: list[int] = field(default_factory=lambda: [100])
    """Rates at which cars are commanded and recorded [Hz]; learned simulators at 100 only."""
    scales: list[float] = field(default_factory=lambda: [BUGGY])
    """Lengths of reference cars over the buggy's; sizes of effects are scaled to them."""

    def __post_init__(self) -> None:
        if self.split not in FIRST:
            raise ValueError(f"split is {self.split!r}: must be one of {', '.join(FIRST)}")
        if self.library not in ("published", "present"):
            raise ValueError(f"library is {self.library!r}: must be published or present")
        unknown = sorted(set(self.pairings) - set(PAIRINGS))
        if unknown:
            raise ValueError(f"no pairings {unknown}; available: {', '.join(PAIRINGS)}")


def drawn(settings: DrawConfig, secret: str = "") -> list[Case]:
    """The cases of a run, by seed."""
    names = {PAIRINGS[name].plant for name in settings.pairings}
    return draw_all(settings, {name: plants.abilities(name) for name in names})


def draw_all(settings: DrawConfig, abilities: dict[str, frozenset[str]]) -> list[Case]:
    """The cases of a run, by seed; the arguments are those of `draw`."""
    first = FIRST[settings.split] + settings.first
    if not settings.each:
        return [draw(first + i, settings, abilities) for i in range(settings.cases)]
    pairings = [PAIRINGS[p] for p in settings.pairings]
    own = [e for p in pairings for e in commanded(p)]
    names = settings.names or [*SIZES, *dict.fromkeys(own)]
    able = set(CAMERA).union(own, *(abilities[p.plant] for p in pairings))
    wanted = [(n,) for n in names if n in able] + [()] * settings.nothing
    # Shuffled: a number that told the effect would leak it.
    random.Random(f"order {first}").shuffle(wanted)
    wanted = wanted[: settings.cases] if settings.cases else wanted
    return [draw(first + i, settings, abilities, concealed) for i, concealed in enumerate(wanted)]


def draw(
    seed: int,
    settings: DrawConfig,
    abilities: dict[str, frozenset[str]],
    names: Sequence[str] | None = None,
) -> Case:
    """The case of one seed.

    Args:
        seed: Same seed and settings, same case.
        settings: What to draw from.
        abilities: Plant -> what can be concealed in it, beside errors of the camera.
        names: What is concealed, where that is not to be drawn.

    Raises:
        ValueError: None of the plants can have it.
    """
    chance = random.Random(seed)
    able = {
        p: _able(p, abilities[p.plant], settings) for p in PAIRINGS.values() if p.plant in abilities
    }
    family = "" if names is not None else chance.choice(settings.families)
    pairings = [PAIRINGS[name] for name in settings.pairings]
    if names is not None:
        pairings = [p for p in pairings if set(names) <= set(able[p])]
    elif family == "unknown":
        # Not every plant has something that the textbook has no name for.
        pairings = [p for p in pairings if set(able[p]) & (set(UNKNOWN_SIZES) - commanded(p))]
    if not pairings:
        raise ValueError(f"seed {seed}: no plant of {settings.pairings} can have {names or family}")
    pairing = chance.choice(pairings)
    if names is None:
        drawable = _drawable(able[pairing], pairing, settings)
        names = _names(chance, family, drawable, pairing, settings)
    nuisance = chance.choice([n for n in settings.nuisances if _suits(n, pairing.simulator)])
    known = SIZES | UNKNOWN_SIZES | {n: COMMANDED_SIZES[n] for n in commanded(pairing)}
    sizes = {n: composed_sizes(n) if is_composed(n) else known[n] for n in names}
    case = Case(
        seed=seed,
        plant=pairing.plant,
        simulator=pairing.simulator,
        baseline=pairing.baseline or nuisance.startswith("parameters"),
        concealed={n: _drawn(chance, sizes[n]) for n in sorted(names)},
        nuisance=nuisance,
        driving=chance.choice(settings.driving),
        seconds=chance.choice(settings.seconds),
        drives=settings.drives,
        held_out=settings.held_out,
        spread=_spread(chance, settings, pairing.simulator),
        command=pairing.command,
        rate=_rate(chance, settings, pairing.simulator),
    )
    return case_at_scale(case, chance.choice(settings.scales))


def case_at_scale(case: Case, scale: float) -> Case:
    """A case of the buggy with a car of another size: sizes of effects and lengths of drives too.

    Raises:
        ValueError: It is not one of the reference car alone, or conceals composed physics.
    """
    if scale == BUGGY:
        return case
    if any(is_composed(effect) for effect in case.concealed):
        raise ValueError("composed physics has the size of the buggy's: scales=[1]")
    large = replace(case, scale=scale)
    ratios = large.car.similarity
    concealed = {e: scaled_effect(e, values, ratios) for e, values in case.concealed.items()}
    return replace(large, concealed=concealed, seconds=round(case.seconds * ratios.time, 2))


def commanded(pairing: Pairing) -> frozenset[str]:
    """Effects that its car can have by its kind of command."""
    return abilities_of(COMMANDS[pairing.command])


def _spread(chance: random.Random, settings: DrawConfig, simulator: str) -> float:
    return chance.choice(settings.spread) if simulator in REFITTED else 0.0


def _rate(chance: random.Random, settings: DrawConfig, simulator: str) -> int:
    rate = chance.choice(settings.rates)
    return RATES[-1] if simulator == "learned" else rate


def _able(pairing: Pairing, can: frozenset[str], settings: DrawConfig) -> list[str]:
    every = can | set(CAMERA) | commanded(pairing)
    return sorted(n for n in every if not settings.names or n in settings.names)


def _drawable(able: Sequence[str], pairing: Pairing, settings: DrawConfig) -> list[str]:
    """Effects, of those that a pairing can have, that are drawn where no names are given."""
    if settings.names:
        return list(able)
    if settings.library == "published":
        return [n for n in able if n in PUBLISHED]
    known = {*offered(COMMANDS[pairing.command]), *UNKNOWN_SIZES}
    return [n for n in able if n in known and n not in NAMED_SINCE]


def _names(
    chance: random.Random, family: str, able: Sequence[str], pairing: Pairing, settings: DrawConfig
) -> list[str]:
    own = commanded(pairing)
    if family == "unknown":
        return [chance.choice([n for n in able if n in UNKNOWN_SIZES and n not in own])]
    if family == "composed":
        return [_composed(chance, SORTS if settings.library == "published" else UNNAMED)]
    return chance.sample([n for n in able if n in SIZES or n in own], COUNT[family])


def _composed(chance: random.Random, sorts: Sequence[str]) -> str:
    """A sort: every place where it may act is as likely, however many signals it has."""
    where = chance.choice(WHERE)
    return chance.choice([name for name in sorts if name.startswith(f"{where}.")])


def _suits(nuisance: str, simulator: str) -> bool:
    if nuisance == "integrator":
        return simulator in INTEGRATED
    return simulator != "learned" or not nuisance.startswith("parameters")


def _drawn(chance: random.Random, sizes: Mapping[str, Uniform]) -> dict[str, float]:
    values = {}
    for name, (low, high, signed, _) in sizes.items():
        side = -1 if signed and chance.random() < 0.5 else 1
        values[name] = round(side * chance.uniform(low, high), 4)
    return values
