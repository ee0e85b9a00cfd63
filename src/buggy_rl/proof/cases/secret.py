"""The secret of a run: what its cases are drawn from and its salts are made from.

SEALED/secret.txt     the secret; one that is put there before the first run is taken
OUTPUT/secret.sha256  its hash, published before anything is asked
OUTPUT/secret.txt     itself, published when the cases were counted
"""

import hashlib
import secrets
from collections.abc import Sequence
from pathlib import Path

from buggy_rl.core.files import write_atomically
from buggy_rl.proof.cases.case import Concealing
from buggy_rl.proof.cases.sealing import CaseStore

BYTES = 32  # of a secret
FILE, HASH = "secret.txt", "secret.sha256"


def secret_of(store: CaseStore) -> str:
    """The secret of a run, made at its first use; its hash is published then.

    Raises:
        ValueError: A hash was published, and the secret is not here or another one.
    """
    file, published = store.sealed / FILE, store.output / HASH
    if not file.exists() and not published.exists():
        write_atomically(file, secrets.token_hex(BYTES) + "\n")
    found = file.read_bytes() if file.exists() else b""
    digest = f"{hashlib.sha256(found).hexdigest()}  {FILE}\n"
    if not published.exists():
        write_atomically(published, digest)
    if published.read_text() != digest:
        raise ValueError(
            f"{file} is not the secret of which {published} is the hash: draw and score where it "
            "was sealed, or use another output"
        )
    return found.decode().strip()


def publish_secret(store: CaseStore) -> Path:
    """Shows the secret: from now on anyone can draw the cases again, and check the hashes."""
    file = store.output / FILE
    write_atomically(file, (store.sealed / FILE).read_bytes())
    return file


def refuse_public_secret(store: CaseStore, cases: Sequence[Concealing]) -> None:
    """Refuses cases that would be sealed with a secret that has been published.

    Raises:
        ValueError: A case has no published hash yet, and the secret is public.
    """
    new, file = [case.id for case in cases if case.id not in store.digests()], store.output / FILE
    if new and file.exists():
        raise ValueError(
            f"{file} is public: anyone can draw case {new[0]} from it, so it cannot be sealed; use "
            "another output"
        )
