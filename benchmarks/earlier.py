"""An earlier diagnosis beside the present one, on the same sealed cases.

    python benchmarks/earlier.py
    python benchmarks/earlier.py answers=runs/earlier commit=1e12cc7 \
        store=runs/proof_third sealed=runs/proof_third_sealed

The first prints what an earlier search said of cases of docs/proof/third, counted as the present
one's answers are. The second enters its answers: a folder of each case with what
`scripts/diagnose.py question.yaml` of that commit wrote, asked in the case's folder of `store`; a
folder without an answer counts as a crash. Repaired simulators are rolled out here, by the present
code, on the drives that are sealed.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from buggy_rl.core.config import from_command_line, run

OF_OTHERS = (
    "  by re-tuning alone",
    "  by a learned residual alone",
    "surely beaten by something simpler",
)
"""Figures that are not of an earlier answer, or were not measured of it."""


@dataclass(frozen=True)
class Config:
    """Which answers are counted."""

    output: str = "benchmarks/results/earlier_1e12cc7.jsonl"
    """JSON lines: a case, its answer, what time left out, distance [m] of what was repaired."""
    ledger: str = "docs/proof/third/ledger.jsonl"
    """Of the cases, opened, with the present answers."""
    answers: str = ""
    """Folder of answers to enter; empty to count those of `output`."""
    commit: str = ""
    """That gave them."""
    store: str = ""
    """Output of the proof, with the cases,"""
    sealed: str = ""
    """and the folder of what is sealed of them."""


def main() -> None:
    """Enters answers, where there are any, and prints the figures."""
    config = from_command_line(__doc__, "earlier:Config")

    from buggy_rl.proof.ledger import Ledger

    entries = {entry.id: entry for entry in Ledger(Path(config.ledger)).entries()}
    if config.answers:
        _enter(config, entries)
    lines = [json.loads(line) for line in Path(config.output).read_text().splitlines()]
    print(table([(entries[line["id"]], line) for line in lines]))


def _enter(config: Config, entries: dict) -> None:
    import torch
    from tqdm import tqdm

    from buggy_rl.proof.cases.sealing import CaseStore
    from buggy_rl.proof.score.outcome import CaseAnswer

    torch.set_num_threads(1)
    store = CaseStore(Path(config.store), Path(config.sealed))
    lines = []
    for folder in tqdm(sorted(Path(config.answers).iterdir()), unit="case"):
        entry, file = entries[folder.name], folder / "diagnosis.json"
        said = json.loads(file.read_text()) if file.exists() else {}
        status = "answered" if said else "crashed"
        answer = CaseAnswer.from_diagnosis(said, {"status": status, "seconds": 0.0})
        line = {"id": entry.id, "commit": config.commit, "answer": asdict(answer)}
        line["left_out"] = [note for note in said.get("notes", ()) if "minutes=" in note]
        line["distance"] = _distance(store, entry, folder / "repaired.yaml")
        lines.append(json.dumps(line) + "\n")
    Path(config.output).write_text("".join(lines))


def _distance(store, entry, file: Path) -> float | None:
    """Median distance [m] after 1 s on the sealed drives; None where nothing was weighed."""
    from buggy_rl.proof.score.weighing import sealed_distance

    return None if "stack" not in entry.weighed else sealed_distance(store, entry.case, file)


def table(pairs: Sequence[tuple]) -> str:
    """Figures of both, and in how many cases or effects exactly one is right."""
    from buggy_rl.proof.markdown import table as markdown
    from buggy_rl.proof.page import indented
    from buggy_rl.proof.score.answers import answer_rows
    from buggy_rl.proof.score.figures import written
    from buggy_rl.proof.score.outcome import CaseAnswer
    from buggy_rl.proof.score.rivals import McNemar
    from buggy_rl.proof.score.stack import clearly_longer
    from buggy_rl.proof.score.strength import VISIBLE
    from buggy_rl.proof.score.weighing import answer_of

    ours = [answer_of(entry.scored(), entry.weighed) for entry, _ in pairs]
    theirs = []
    for own, (_, line) in zip(ours, pairs, strict=True):
        scored = replace(own.scored, answer=CaseAnswer.from_dict(line["answer"]))
        stack = own.stack
        if stack is not None:
            stack = replace(stack, distance={**stack.distance, "stack": line["distance"]})
        theirs.append(replace(own, scored=scored, stack=stack))
    both = theirs, ours
    rows = []
    for first, second in zip(*map(answer_rows, both), strict=True):
        if first.name in OF_OTHERS:
            continue
        counts = f"{first.figure.count}, {second.figure.count}"
        figures = (written(row.figure, row.percent) for row in (first, second))
        rows.append([indented(first.name), *figures, counts])
    right = {
        "cases exactly right": lambda c: [c.scored.all_right],
        "cases right by names above one half": lambda c: [c.scored.given_right],
        f"effects above {VISIBLE:g} nats that are named": lambda c: [
            n in c.given for n in c.visible
        ],
        "cases without a wrong name": lambda c: [not c.wrong],
    }
    for name, hits in right.items():
        first, second = ([hit for case in cases for hit in hits(case)] for cases in both)
        test = McNemar.of(first, second)
        name = f"{name} (alone {test.wins} : {test.losses}, p = {test.p:.2g})"
        rows.append([name, *map(str, (sum(first), sum(second), len(first)))])
    stacks = [(a.stack, b.stack) for a, b in zip(*both, strict=True)]
    ends = [(a.distance["stack"], b.distance["stack"]) for a, b in stacks if a and b]
    test = McNemar.of(
        [clearly_longer(b, a) for a, b in ends], [clearly_longer(a, b) for a, b in ends]
    )
    name = f"cases whose repaired simulator is the nearer one (p = {test.p:.2g})"
    rows.append([name, str(test.wins), str(test.losses), str(len(ends))])
    entry, line = pairs[0]
    head = (f"figure, {len(pairs)} cases", line["commit"], entry.made["commit"][:7], "n")
    return markdown(head, rows)


if __name__ == "__main__":
    run(main)
