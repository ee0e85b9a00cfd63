"""Outcomes that are settled, one JSON line a case: a proof goes on from them on any machine.

What a case was, what was said of it by whom, and how well, is all that counting needs. So the score
and its page can be made again from this file, without driving or asking anything once more.
"""

import json
from collections.abc import Sequence
from pathlib import Path

from buggy_rl.blind_test.again import again, asked_for
from buggy_rl.blind_test.baselines import missing
from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.exam import finished
from buggy_rl.blind_test.outcome import OURS, Outcome, gathered
from buggy_rl.blind_test.sealing import Vault


class Ledger:
    """Settled cases.

    Args:
        file: Is there, or is made when the first case is settled.
    """

    def __init__(self, file: Path) -> None:
        self.file = file

    def entries(self) -> dict[str, dict[str, Outcome]]:
        """Case -> who answered -> outcome.

        Raises:
            ValueError: A line is none of a ledger; the message names file and line.
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
                    f"{self.file}, line {number}: no settled case ({error}); take the line out, "
                    "and the case is asked again"
                ) from error
        return found

    def open(self, cases: Sequence[Case]) -> list[Case]:
        """Those of the cases that are not settled.

        Raises:
            ValueError: A settled case was another one: the file is of other settings.
        """
        entries = self.entries()
        for case in cases:
            if case.id in entries and entries[case.id][OURS].case != case:
                raise ValueError(
                    f"{self.file}: case {case.id} was drawn by other settings: use another file"
                )
        return [case for case in cases if case.id not in entries]

    def settle(self, vault: Vault, compared: bool = True) -> int:
        """Enters all cases of a vault that are done with; how many.

        Args:
            vault: Where they lie.
            compared: Whether other methods must have answered too. They must in any case once they
                have begun to: a settled case is not asked again, and theirs would be lost.
        """
        entries, new = self.entries(), []
        by_case: dict[str, dict[str, Outcome]] = {}
        found = gathered(vault)
        compared = compared or len(found) > 1
        for who, outcomes in found.items():
            for outcome in outcomes:
                by_case.setdefault(outcome.case.id, {})[who] = outcome
        for id_, outcomes in by_case.items():
            if id_ not in entries and whole(vault, outcomes[OURS].case, compared):
                told = {who: outcome.to_dict() for who, outcome in outcomes.items()}
                new.append(json.dumps({"id": id_, "outcomes": told}) + "\n")
        if new:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with open(self.file, "a") as file:
                file.writelines(new)
        return len(new)


def whole(vault: Vault, case: Case, compared: bool = True) -> bool:
    """Whether nothing of a case is left to do."""
    asked_again = not asked_for(vault, case) or finished(vault.said(again(case)))
    return (
        finished(vault.said(case.id))
        and vault.is_weighed(case.id)
        and asked_again
        and not (compared and missing(vault, case))
    )


def outcomes(ledger: Ledger, vault: Vault, cases: Sequence[Case]) -> dict[str, list[Outcome]]:
    """Of all cases that have one, by who answered: settled ones, and those of the vault."""
    entries = ledger.entries()
    found: dict[str, list[Outcome]] = {OURS: []}
    wanted = {case.id for case in cases}
    for id_ in sorted(wanted & set(entries)):
        for who, outcome in entries[id_].items():
            found.setdefault(who, []).append(outcome)
    for who, others in gathered(vault).items():
        found.setdefault(who, []).extend(
            o for o in others if o.case.id in wanted and o.case.id not in entries
        )
    return {who: sorted(each, key=lambda o: o.case.id) for who, each in found.items()}
