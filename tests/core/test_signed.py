"""Pickles in a folder that may have been handed on."""

import io
import os

import pytest
import torch

from buggy_rl.core import files as signed
from buggy_rl.core.files import is_own, load_signed, save_signed


@pytest.fixture
def user(tmp_path, monkeypatch):
    """Makes this process that of a user with a cache folder of their own."""

    def be(name):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / name))
        signed._key.cache_clear()

    be("me")
    yield be
    signed._key.cache_clear()


class Attack:
    def __init__(self, ran):
        self.ran = ran

    def __reduce__(self):
        return os.system, (f"touch {self.ran}",)


def test_what_the_user_wrote_is_read_back(user, tmp_path):
    file = tmp_path / "search.pt"
    save_signed(file, {"weights": torch.arange(3), "best": ("a", 1.5)})
    signed._key.cache_clear()  # another process
    assert load_signed(file)["weights"].tolist() == [0, 1, 2]
    assert is_own(file)
    key = tmp_path / "me" / "buggy_rl" / "signing_key"
    assert key.stat().st_mode & 0o077 == 0
    assert len(list(key.parent.iterdir())) == 1


def test_what_another_user_wrote_is_not_run(user, tmp_path):
    ran, file = tmp_path / "ran", tmp_path / "search.pt"
    user("attacker")
    save_signed(file, Attack(ran))
    user("me")
    assert not is_own(file)
    with pytest.raises(ValueError, match=r"search\.pt was not written by this user"):
        load_signed(file)
    assert not ran.exists()


@pytest.mark.parametrize("attack", ["unsigned", "changed", "renamed", "cut"])
def test_what_was_made_of_a_file_of_the_users_is_not_run(user, tmp_path, attack):
    ran, file = tmp_path / "ran", tmp_path / "search.pt"
    save_signed(file, [1])
    buffer = io.BytesIO()
    torch.save(Attack(ran), buffer)
    if attack == "unsigned":
        file.write_bytes(buffer.getvalue())
    elif attack == "changed":
        head = file.read_bytes()[: len(signed.MARK) + signed.SIZE]
        file.write_bytes(head + buffer.getvalue())
    elif attack == "renamed":
        file = file.rename(tmp_path / "answer.pt")
    else:
        file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(ValueError, match="was not written by this user"):
        load_signed(file)
    assert not ran.exists()


def test_where_no_key_can_be_kept_one_process_reads_its_own(user, tmp_path):
    (tmp_path / "file").write_text("")
    user("file")  # a folder cannot be made there
    save_signed(tmp_path / "a.pt", [1])
    assert load_signed(tmp_path / "a.pt") == [1]
    signed._key.cache_clear()
    assert not is_own(tmp_path / "a.pt")
