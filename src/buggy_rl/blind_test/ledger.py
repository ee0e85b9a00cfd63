"""Scored cases, one JSON line each: a run goes on from them on any machine.

The score and its page can be made again from this file, without driving or diagnosing a case again.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from buggy_rl.blind_test.again import again, suggested
from buggy_rl.blind_test.baselines import missing
from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.outcome import OURS, Outcome, read_outcomes
from buggy_rl.blind_test.sealing import CaseStore
from buggy_rl.files import write_json


@dataclass(frozen=True)
class Ledger:
    """Scored cases in a file, which is made when the first one is entered."""

    file: Path

    def entries(self) -> dict[str, dict[str, Outcome]]:
        """Case -> method -> outcome.

        Raises:
            ValueError: A line is not a ledger's; the message names file and line.
        """
        if not self.file.exists():
            return {}
        found = {}
        for number, line in enumerate(self.file.read_text().splitlines(), 1):
            try:
                entry = json.loads(line)
                found[entry["id"]] = {
                    who: Outcome.from_dict(content) for who, content in entry["outcomes"].items()
                }
            except (KeyError, TypeError, ValueError) as error:
                raise ValueError(
                    f"{self.file}, line {number}: not a scored case ({error}); take the line out, "
                    "and the case is run again"
                ) from error
        return found

    def open(self, cases: Sequence[Case]) -> list[Case]:
        """Those of the cases that are not entered.

        Raises:
            ValueError: An entered case differs: the file is of other settings.
        """
        entries = self.entries()
        for case in cases:
            if case.id in entries and entries[case.id][OURS].case != case:
                raise ValueError(
                    f"{self.file}: case {case.id} was drawn by other settings: use another file"
                )
        return [case for case in cases if case.id not in entries]

    def settle(self, store: CaseStore, compared: bool = True) -> int:
        """Enters all complete cases of a store; how many.

        With `compared` other methods must have an answer too. They must in any case once they have
        begun: a case in the ledger is not run again, and their answers would be lost.
        """
        entries = self.entries()
        found = read_outcomes(store)
        compared = compared or len(found) > 1
        lines = []
        for own in found[OURS]:
            id_ = own.case.id
            if id_ in entries or not complete(store, own.case, compared):
                continue
            told = {who: asdict(o) for who, each in found.items() for o in each if o.case.id == id_}
            lines.append(json.dumps({"id": id_, "outcomes": told}) + "\n")
        if lines:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with open(self.file, "a") as file:
                file.writelines(lines)
        return len(lines)

    def outcomes(self, store: CaseStore, cases: Sequence[Case]) -> dict[str, list[Outcome]]:
        """Outcomes of the cases by method, by case: from the ledger, else from the store."""
        entries = self.entries()
        wanted = {case.id for case in cases}
        found: dict[str, list[Outcome]] = {OURS: []}
        for id_ in sorted(wanted & set(entries)):
            for who, outcome in entries[id_].items():
                found.setdefault(who, []).append(outcome)
        for who, others in read_outcomes(store).items():
            new = [o for o in others if o.case.id in wanted and o.case.id not in entries]
            found.setdefault(who, []).extend(new)
        return {who: sorted(each, key=lambda o: o.case.id) for who, each in found.items()}


def complete(store: CaseStore, case: Case, compared: bool = True) -> bool:
    """Whether nothing of a case is left to run."""
    return (
        store.weighed(case.id)
        and (store.diagnosed(again(case)) or not suggested(store, case))
        and not (compared and missing(store, case))
    )


def openings(file: Path) -> int:
    """How often sealed cases were scored: each time is one more chance to tune to them."""
    return json.loads(file.read_text())["opened"] if file.exists() else 0


def open_once(file: Path) -> int:
    """Counts one more; how often that is."""
    count = openings(file) + 1
    write_json(file, {"opened": count})
    return count
