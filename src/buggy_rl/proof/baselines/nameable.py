"""Effects that a method can name in a case, whatever it says there."""

from functools import cache

from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.effects import offered
from buggy_rl.estimation.hypothesis import OWN, Library
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.equivalents import meant
from buggy_rl.simulators import make_engine

FITTED = "_fitted"  # ends the name of a simulator whose parameters were fitted first
MUJOCO = "mujoco"
LEARNED = "learned"  # declares no parameters


def library(case: Case) -> frozenset[str]:
    """All effects that a car with the case's command can have."""
    return frozenset(offered(case.longitudinal))


def nothing(case: Case) -> frozenset[str]:
    """No effect."""
    del case
    return frozenset()


def parameters(case: Case) -> frozenset[str]:
    """Effects that are a parameter of the case's simulator by another name."""
    engine = case.simulator.removesuffix(FITTED)
    return frozenset() if engine == LEARNED else by_one_parameter(engine, case.longitudinal)


def inside_mujoco(case: Case) -> frozenset[str] | None:
    """Effects that are a change of parameters of the MuJoCo car; None of another simulator."""
    if case.simulator.removesuffix(FITTED) != MUJOCO:
        return None
    engine = make_engine(MUJOCO, 1, command=case.longitudinal.plain)
    found = Library(None, engine.declared, realises=engine.realises).inside.changes
    return by_one_parameter(MUJOCO, case.longitudinal) | {*found}


@cache
def by_one_parameter(engine: str, command: LongitudinalCommand) -> frozenset[str]:
    """Effects of the same name, or meaning, as a parameter of an engine."""
    declared = make_engine(engine, 1, command=command.plain).declared
    names = (meant(OWN + name) for name in declared)
    return frozenset(name for name in names if not name.startswith(OWN))
