"""Bars on a terminal, plain lines elsewhere."""

import io
import time

import pytest

from buggy_rl.jobs import bar
from buggy_rl.jobs.bar import PERIOD, tqdm


class Terminal(io.StringIO):
    """A file that is a terminal."""

    def isatty(self) -> bool:
        return True


def written(file, **keywords) -> str:
    """What a bar of 100 steps writes in 0.2 s, its text changed and shown at each of them."""
    with tqdm(total=100, desc="driving", file=file, **keywords) as shown:
        for number in range(100):
            shown.set_postfix_str(f"drive {number}")
            shown.update()
            time.sleep(0.002)
    return file.getvalue()


def test_into_a_pipe_a_line_is_written_at_the_end_and_none_at_each_step():
    text = written(io.StringIO())
    assert text.endswith("\n")
    assert "\r" not in text
    [line] = text.splitlines()
    assert line.startswith("driving: 100%|")
    assert "100/100" in line
    assert "drive 99" in line


def test_into_a_pipe_a_line_is_written_each_period(monkeypatch):
    monkeypatch.setenv(PERIOD, "0.05")
    lines = written(io.StringIO()).splitlines()
    assert 3 <= len(lines) <= 12  # 0.2 s or, on a busy machine, some more
    assert all(line.startswith("driving: ") for line in lines)
    assert bar.EVERY == 10


@pytest.mark.parametrize("given", [{}, {"bar_format": "{elapsed} {desc}"}])
def test_on_a_terminal_it_is_a_bar_in_one_line(given):
    text = written(Terminal(), mininterval=0.02, **given)
    assert text.count("\r") > 5
    assert text.count("\n") == 1


def test_lines_beside_a_plain_bar_leave_it_alone(capsys):
    for number in tqdm(range(3)):
        tqdm.write(f"said {number}")
    seen = capsys.readouterr()
    assert seen.out == "said 0\nsaid 1\nsaid 2\n"
    assert len(seen.err.splitlines()) == 1


def test_a_bar_that_is_off_writes_nothing():
    assert written(io.StringIO(), disable=True) == ""
    assert written(io.StringIO(), leave=False) == ""
