"""The secret of a run: one, random, its hash shown before and itself after."""

import hashlib

import pytest

from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import CaseStore, publish, sealed_text
from buggy_rl.proof.cases.secret import publish_secret, refuse_public_secret, secret_of

CASES = [Case(n, "reference", "reference") for n in range(2)]


def store(folder) -> CaseStore:
    made = CaseStore(folder / "open", folder / "safe")
    for place in (made.output, made.sealed):
        place.mkdir(parents=True)
    return made


def test_a_secret_is_made_once_and_shown_when_it_is_published(tmp_path):
    made = store(tmp_path)
    secret = secret_of(made)
    assert len(secret) == 64
    assert secret_of(made) == secret
    assert not (made.output / "secret.txt").exists()
    shown = publish_secret(made)
    digest = hashlib.sha256(shown.read_bytes()).hexdigest()
    assert (made.output / "secret.sha256").read_text() == f"{digest}  secret.txt\n"
    other = store(tmp_path / "other")
    assert secret_of(other) != secret


def test_a_secret_that_was_put_there_is_taken(tmp_path):
    made = store(tmp_path)
    (made.sealed / "secret.txt").write_text("chosen\n")
    assert secret_of(made) == "chosen"


def test_another_secret_than_the_published_one_is_refused(tmp_path):
    made = store(tmp_path)
    secret_of(made)
    (made.sealed / "secret.txt").write_text("another\n")
    with pytest.raises(ValueError, match=r"is not the secret of which .* is the hash"):
        secret_of(made)
    (made.sealed / "secret.txt").unlink()
    with pytest.raises(ValueError, match="is not the secret"):
        secret_of(made)


def test_nothing_is_sealed_with_a_secret_that_is_public(tmp_path):
    made = store(tmp_path)
    publish(made, CASES[:1], secret_of(made))
    refuse_public_secret(made, CASES)
    publish_secret(made)
    refuse_public_secret(made, CASES[:1])  # sealed before: only counted again
    with pytest.raises(ValueError, match="anyone can draw case 0000001"):
        refuse_public_secret(made, CASES)


def test_salts_come_from_the_secret_and_all_sealed_texts_are_of_one_size():
    concealed = {"wind": {"force_x": 0.2, "force_y": -0.3}, "payload": {"mass_ratio": 1.3}}
    full = Case(3, "reference", "reference", concealed=concealed)
    assert sealed_text(full, "a") != sealed_text(full, "b")
    assert {len(sealed_text(case, "a")) for case in (*CASES, full)} == {4096}
