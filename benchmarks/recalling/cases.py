"""Cases of one effect each, and the table of what is named in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zlib import crc32

from buggy_rl.diagnosis.search.case_evidence import CaseEvidence
from buggy_rl.diagnosis.search.posterior import posterior
from buggy_rl.effects import OF_A_COMMAND, effect_class
from buggy_rl.jobs.launching import Launching
from buggy_rl.proof.calibrate.calibration import truth
from buggy_rl.proof.calibrate.development import entries
from buggy_rl.proof.calibrate.named import sure
from buggy_rl.proof.cases.case import COMMANDS, Case
from buggy_rl.proof.cases.sizes import COMMANDED_SIZES, SIZES, Uniform
from buggy_rl.proof.plants.faults import PLACES

STRENGTHS = {"faint": 0.0, "middle": 0.5, "strong": 1.0}
"""Share of the way from the fainter end of the generator's range to the stronger one."""
PLACED = 0.5  # likewise of where a patch lies, which is no strength
FIRST = 950_000  # seeds begin here
EFFECTS = 15_000  # at most; many more than there are, so that no two have one seed


@dataclass(frozen=True)
class RecallConfig(Launching):
    """What to search."""

    names: list[str] = field(default_factory=list)
    """Effects; empty for all that the generator can conceal in the reference car."""
    stretches: int = 48
    """Segments of 1 s that are searched."""
    workers: int = 2
    """Groups of cases at a time."""
    folder: str = "runs/recall"
    """Folder of cases while they are worked on."""
    output: str = "runs/recall/recall.jsonl"
    """Ledger; a case in it is not run again."""
    cases: bool = True
    """Whether the cases that are left are searched; else the ledger is only read."""
    pages: list[str] = field(default_factory=list)
    """Markdown files whose table of effects gets its last column from the ledger."""


def left(config: RecallConfig) -> list[Case]:
    """Cases that are not in the output."""
    done = {entry["case"]["seed"] for entry in entries(Path(config.output))}
    every = cases()
    wanted = config.names or list(dict.fromkeys(c.truth[0] for c in every))
    return [c for c in every if c.truth[0] in wanted and c.seed not in done]


def cases() -> list[Case]:
    """All of them: every effect at every strength, in the reference car."""
    found = []
    for name, ranges in (SIZES | COMMANDED_SIZES).items():
        for number, share in enumerate(STRENGTHS.values()):
            found.append(
                Case(
                    seed=seed_of(name) + number,
                    plant="reference",
                    simulator="reference",
                    concealed={name: _values(name, ranges, share)},
                    seconds=30.0,
                    command=_command(name),
                )
            )
    return found


def seed_of(name: str) -> int:
    """Seed of the faint case of an effect; other effects may come and go."""
    return FIRST + len(STRENGTHS) * (crc32(name.encode()) % EFFECTS)


def strength(case: Mapping[str, Any]) -> str:
    """Faint, middle or strong, of a case as a ledger has it."""
    return list(STRENGTHS)[(case["seed"] - FIRST) % len(STRENGTHS)]


def _values(name: str, ranges: Mapping[str, Uniform], strength: float) -> dict[str, float]:
    """Numbers between the fainter and the stronger end; the fainter is nearer to neutral."""
    neutral = {p.name: p.value for p in effect_class(name).declared}
    values = {}
    for parameter, (low, high, _, _) in ranges.items():
        share = PLACED if f"{name}.{parameter}" in PLACES else strength
        faint, strong = sorted((low, high), key=lambda v: abs(v - neutral[parameter]))
        values[parameter] = round(faint + share * (strong - faint), 4)
    return values


def _command(name: str) -> str:
    """The kind of command, of `COMMANDS`, that a car needs to have the effect."""
    if name not in OF_A_COMMAND:
        return "throttle"
    [key] = [key for key, command in COMMANDS.items() if command.kind == OF_A_COMMAND[name][1]]
    return key


def table(lines: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: an effect a row, what is named first at each strength and how probable it is."""
    rows: dict[str, dict[str, str]] = {}
    right = 0
    for entry in lines:
        [name] = truth(entry)
        cell, hit = _named(entry, name)
        rows.setdefault(name, {})[strength(entry["case"])] = cell
        right += hit
    header = ["| effect | " + " | ".join(STRENGTHS) + " |", "|---|" + "---|" * len(STRENGTHS)]
    body = [
        f"| `{name}` | " + " | ".join(row.get(s, "") for s in STRENGTHS) + " |"
        for name, row in rows.items()
    ]
    return "\n".join([*header, *body, f"\nfirst name right: {right} of {len(lines)}"])


def first_named(entry: Mapping[str, Any]) -> tuple[str, bool]:
    """The effect that is concealed in a case, and whether it is named first."""
    [name] = truth(entry)
    return name, _named(entry, name)[1]


def _named(entry: Mapping[str, Any], name: str) -> tuple[str, bool]:
    """What is said of a case, and whether its effect is named first."""
    if "failed" in entry:
        return f"refused: {entry['failed'].partition(':')[2].strip()[:60]}", False
    said = posterior(CaseEvidence.from_dict(entry))
    if said.says in ("nothing", "unknown"):
        return f"{said.says} ({100 * said.of(name):.0f} %)", False
    probable = sure(said)
    first = max(probable, key=lambda e: probable[e])
    if first == name:
        return f"{100 * probable[first]:.0f} %", True
    return f"{first} {100 * probable[first]:.0f} % ({100 * said.of(name):.0f} %)", False
