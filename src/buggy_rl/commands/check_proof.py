"""Checks that published sealed cases are what was sealed.

    python scripts/check_proof.py folder=runs/proof_third config=configs/proof_third.yaml
    python scripts/check_proof.py folder=runs/proof_real config=configs/proof_real.yaml

`last=2000599` where the count was to end before the last case that was sealed: that case and all
before it have to be there.

The secret has the hash that was published before the first question, what was concealed in each
case has its published hash, no case is left out, and (with `config`) the secret draws these cases
and no others: nobody chose them; edited recordings are drawn again from the recordings that the
config names. When the hashes were committed is said by
`git log --follow FOLDER/hashes.txt`.
"""

from dataclasses import dataclass
from pathlib import Path

from omegaconf import MISSING

from buggy_rl.core.config import from_command_line, run


@dataclass(frozen=True)
class CheckProofConfig:
    """What to check."""

    folder: str = MISSING
    """Folder of secret.sha256, hashes.txt, secret.txt and ledger.jsonl (or .gz)."""
    config: str = ""
    """Config of the run, of `prove` or `prove_real`: the cases are drawn again; empty checks hashes
    alone."""
    last: str = ""
    """Last case that is counted; empty: the last that was sealed."""


def main() -> None:
    """Checks and prints what holds; ends with one line where something does not."""
    config = from_command_line(__doc__, "buggy_rl.commands.check_proof:CheckProofConfig")

    from buggy_rl.proof.checking import checked, drawn_again, published

    found = published(Path(config.folder))
    again = drawn_again(found, config.config) if config.config else []
    print("\n".join(checked(found, again, config.last)))


if __name__ == "__main__":
    run(main)
