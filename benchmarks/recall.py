"""Every effect of the library concealed in the reference car at three strengths, and what is named.

    python -m benchmarks.recall
    python -m benchmarks.recall "names=[understeer,voltage_sag]" workers=1
    python -m benchmarks.recall cases=false "pages=[README.md]" \
        output=docs/development/recall.jsonl.gz

Two drives of 30 s for each effect and strength; the simulator is the same car without the effect,
as a black box; the whole library and the shipped weights. Prints a row for each effect. One ledger
line a case in `output`, as of `scripts/develop.py`; it resumes: cases in the output are kept.
With `cases=false` the output is only read; `pages` get their column "named first" from it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from zlib import crc32

from buggy_rl.core.config import from_command_line, run
from buggy_rl.effects import OF_A_COMMAND, effect_class
from buggy_rl.jobs.bar import tqdm
from buggy_rl.jobs.launching import Launching
from buggy_rl.proof.calibrate.development import Searching, parts_of
from buggy_rl.proof.cases.case import COMMANDS, Case
from buggy_rl.proof.cases.sealing import CaseStore
from buggy_rl.proof.cases.sizes import COMMANDED_SIZES, SIZES, Uniform
from buggy_rl.proof.ledger import Entry, Ledger
from buggy_rl.proof.markdown import marked, with_table
from buggy_rl.proof.plants.faults import PLACES
from buggy_rl.proof.score.outcome import NAMELESS

STRENGTHS = {"faint": 0.0, "middle": 0.5, "strong": 1.0}
"""Share of the way from the fainter end of the generator's range to the stronger one."""
PLACED = 0.5  # likewise of where a patch lies, which is no strength
FIRST = 950_000  # seeds begin here
EFFECTS = 15_000  # at most; many more than there are, so that no two have one seed
PART = 4  # cases of a job
PLACE = "recall"  # of the table in a page, between its marks
NOT_MEASURED = "–"


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

    @property
    def lines(self) -> Ledger:
        """The ledger."""
        return Ledger(Path(self.output))

    @property
    def left(self) -> list[Case]:
        """Cases that are wanted and not in the ledger."""
        every = cases()
        wanted = self.names or list(dict.fromkeys(c.truth[0] for c in every))
        return self.lines.left([c for c in every if c.truth[0] in wanted])


def main() -> None:
    """Searches what is left of the cases, prints the table and fills in pages."""
    config = from_command_line(__doc__, "benchmarks.recall:RecallConfig")
    if config.cases:
        _search(config)
    entries = config.lines.entries()
    print(table(entries))
    for page in config.pages:
        file = Path(page)
        file.write_text(written(file.read_text(), column(entries)))


def _search(config: RecallConfig) -> None:
    folder, left = Path(config.folder), config.left
    searching = Searching(CaseStore(folder, folder / "truth"), "recall", stretches=config.stretches)
    with tqdm(desc="searching", total=len(left), unit="case") as bar:
        for count in searching.into(config.lines, parts_of(left, PART), config.workers, config):
            bar.update(count)


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


def strength(case: Case) -> str:
    """Faint, middle or strong."""
    return list(STRENGTHS)[(case.seed - FIRST) % len(STRENGTHS)]


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


def table(entries: Sequence[Entry]) -> str:
    """Markdown: an effect a row, what is named first at each strength and how probable it is."""
    rows: dict[str, dict[str, str]] = {}
    for entry in entries:
        [name] = entry.case.truth
        rows.setdefault(name, {})[strength(entry.case)] = _cell(entry, name)
    header = ["| effect | " + " | ".join(STRENGTHS) + " |", "|---|" + "---|" * len(STRENGTHS)]
    body = [
        f"| `{name}` | " + " | ".join(row.get(s, "") for s in STRENGTHS) + " |"
        for name, row in rows.items()
    ]
    right = sum(map(named_first, entries))
    return "\n".join([*header, *body, f"\nfirst name right: {right} of {len(entries)}"])


def named_first(entry: Entry) -> bool:
    """Whether the effect that is concealed is named first; not where the search failed."""
    return not entry.failed and entry.scored(entry.posterior()).first_right


def _cell(entry: Entry, name: str) -> str:
    """What is said of a case, and how probable its effect is."""
    if entry.failed:
        return f"refused: {entry.failed.partition(':')[2].strip()[:60]}"
    answer = entry.scored(entry.posterior()).answer
    own = f"{100 * answer.probable.get(name, 0.0):.0f} %"
    if answer.verdict in NAMELESS:
        return f"{'nothing' if answer.verdict == 'no_mismatch' else 'unknown'} ({own})"
    first = answer.most_probable
    return own if first == name else f"{first} {100 * answer.probable[first]:.0f} % ({own})"


def column(entries: Sequence[Entry]) -> dict[str, str]:
    """Effect -> in how many of its cases it is named first, as `2 of 3`."""
    right: dict[str, list[bool]] = {}
    for entry in entries:
        [name] = entry.case.truth
        right.setdefault(name, []).append(named_first(entry))
    return {name: f"{sum(hits)} of {len(hits)}" for name, hits in right.items()}


def written(text: str, cells: Mapping[str, str]) -> str:
    """A page's text with the last column of its table filled in.

    Args:
        text: Of a page; the rows of its table begin with an effect's name.
        cells: Of that column, by effect; `NOT_MEASURED` stands for the others.

    Raises:
        ValueError: The page has no marks, or no row for an effect.
    """
    rows, left = [], dict(cells)
    for line in marked(text, PLACE)[1].splitlines():
        if line.startswith("| `"):
            name = line.split("`")[1]
            kept = line.rstrip().removesuffix("|").rpartition("|")[0]
            line = f"{kept}| {left.pop(name, NOT_MEASURED)} |"
        rows.append(line)
    if left:
        raise ValueError(f"the table has no row for {', '.join(left)}: write one")
    return with_table(text, PLACE, "\n".join(rows))


if __name__ == "__main__":
    run(main)
