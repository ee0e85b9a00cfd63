"""Whether a published run of sealed cases is what was sealed: what a stranger can check of it.

FOLDER/secret.sha256, hashes.txt  published before the first question
FOLDER/secret.txt, ledger.jsonl   published when the cases were counted; the ledger may be .gz
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from buggy_rl.core.config import build
from buggy_rl.proof.cases.case import Concealing
from buggy_rl.proof.cases.draw import drawn
from buggy_rl.proof.cases.sealing import CaseStore, sealed_text
from buggy_rl.proof.cases.secret import FILE, HASH
from buggy_rl.proof.ledger import Entry, Ledger, answered_by
from buggy_rl.proof.proof import ProofConfig
from buggy_rl.proof.real.case import RealCase
from buggy_rl.proof.real.dataset import load_datasets
from buggy_rl.proof.real.draw import drawn as drawn_from_recordings
from buggy_rl.proof.real.real import RealProofConfig

LEDGERS = ("ledger.jsonl", "ledger.jsonl.gz")


@dataclass(frozen=True)
class Published:
    """What a folder has."""

    folder: Path
    secret: str
    digests: dict[str, str]
    """Case -> published hash of what is concealed in it."""
    entries: list[Entry]


def published(folder: Path) -> Published:
    """Opens a folder; the secret is the one whose hash was published.

    Raises:
        FileNotFoundError: A file is missing.
        ValueError: The secret has another hash.
    """
    if not (folder / FILE).exists() and (folder / HASH).exists():
        raise FileNotFoundError(
            f"{folder / FILE} is not there: it is published when all cases were counted, and what "
            "was concealed can be checked from then on"
        )
    text = (folder / FILE).read_bytes()
    digest = (folder / HASH).read_text().split()[0]
    if hashlib.sha256(text).hexdigest() != digest:
        raise ValueError(f"{folder / FILE} is not the secret of which {folder / HASH} is the hash")
    ledgers = [folder / name for name in LEDGERS if (folder / name).exists()]
    if not ledgers:
        raise FileNotFoundError(f"{folder} has no {' or '.join(LEDGERS)}")
    digests = CaseStore(folder, folder).digests()
    if not digests:
        raise FileNotFoundError(f"{folder} has no hashes.txt, or an empty one")
    return Published(folder, text.decode().strip(), digests, Ledger(ledgers[0]).entries())


def drawn_again(found: Published, config: str) -> Sequence[Concealing]:
    """The cases that the secret draws, by the config of the run.

    Args:
        found: What was published.
        config: Of `prove`, or of `prove_real` where recordings were edited: those that it names are
            read.
    """
    if any(isinstance(entry.opened, RealCase) for entry in found.entries):
        real = build(RealProofConfig, [config])
        return drawn_from_recordings(real.draw, load_datasets(real.datasets), found.secret)
    return drawn(build(ProofConfig, [config]).draw, found.secret)


def checked(found: Published, again: Sequence[Concealing] = (), last: str = "") -> list[str]:
    """Checks every line of the ledger, and says what holds.

    Args:
        found: What was published.
        again: The cases drawn again from the secret; empty where they are not.
        last: Last case that is counted, where more were sealed; empty: all of them are.

    Raises:
        ValueError: Something is not as it was sealed; the message names the case.
    """
    opened = {entry.id: entry for entry in found.entries if entry.opened is not None}
    if last and last not in found.digests:
        raise ValueError(f"last={last}: no such case was sealed")
    counted = {id_ for id_ in found.digests if not last or id_ <= last}
    if unopened := sorted(counted - set(opened)):
        raise ValueError(
            f"case {unopened[0]} was sealed and is not in the ledger, or not opened there; "
            f"{len(unopened)} of {len(counted)} are not"
        )
    for id_, entry in opened.items():
        text = sealed_text(entry.case, found.secret)
        if hashlib.sha256(text.encode()).hexdigest() != found.digests.get(id_):
            raise ValueError(f"case {id_}: what the ledger says was concealed has another hash")
    lines = [
        f"secret: its hash is the one in {HASH}",
        f"{len(opened)} cases: what was concealed has the published hash, and none is left out",
    ]
    if beyond := set(found.digests) - set(opened):
        lines.append(f"{len(beyond)} that were sealed come after {last} and were never opened")
    if again:
        drawn = {case.id: case for case in again}
        if off := sorted(id_ for id_, entry in opened.items() if drawn.get(id_) != entry.case):
            raise ValueError(f"case {off[0]} is not what the secret draws; {len(off)} are not")
        if absent := sorted(set(drawn) - set(found.digests)):
            raise ValueError(f"case {absent[0]} was drawn, not sealed; {len(absent)} were not")
        lines.append(f"{len(opened)} cases are what the secret draws: nobody chose them")
    return [*lines, *answered_by(list(opened.values()))]
