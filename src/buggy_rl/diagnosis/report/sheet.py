"""What stands on the page beside the answer: what was asked, when, by what; the repaired file."""

import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import yaml

from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.engines import simulator_name

BUGGY = "the buggy (no car= was given)"


@dataclass(frozen=True)
class Sheet:
    """Facts of a diagnosis that are in neither the case nor the answer."""

    facts: Mapping[str, str] = field(default_factory=dict)
    """Label -> value, at the foot of the page."""
    repaired: str = ""
    """Content of repaired.yaml; empty where it is not known."""


def sheet_of(config: DiagnosisConfig, repaired: Mapping[str, Any]) -> Sheet:
    """The sheet of a diagnosis by this process, today.

    Args:
        config: The question.
        repaired: Content of repaired.yaml.
    """
    try:
        release = version("buggy_rl")
    except PackageNotFoundError:  # run from a source tree that is not installed
        release = "not installed"
    script = Path(sys.argv[0])
    words = [f"{script.parent.name}/{script.name}" if script.parent.name else script.name]
    verb = script.name.startswith("buggy-rl ")  # it is a program by itself
    words = script.name.split() if verb else ["python", *words]
    facts = {
        "Simulator": simulator_name(config.simulator),
        "Car": config.car or BUGGY,
        "Recordings": ", ".join(config.recordings),
        **({"Baseline": ", ".join(config.baseline)} if config.baseline else {}),
        "Date": date.today().isoformat(),
        "Version": f"buggy_rl {release}",
        "Command": shlex.join([*words, *sys.argv[1:]]),
    }
    return Sheet(facts, yaml.safe_dump(dict(repaired), sort_keys=False))
