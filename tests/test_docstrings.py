"""Docstrings: the first line of each names its subject, so that it reads without the signature."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "buggy_rl"
FILES = sorted(SOURCE.rglob("*.py"))

PREPOSITIONS = """about above across after against along among around as at because before behind
below beneath beside besides between beyond by despite during except for from if in inside instead
into like likewise near of off on once only outside over per since so than then through to toward
towards under unless until up upon via when whenever where whereas wherever while with within
without"""
CONJUNCTIONS = "and but nor or though although yet"
PRONOUNS = "he her his it its she that their theirs them they those"
LEANING = {*PREPOSITIONS.split(), *CONJUNCTIONS.split(), *PRONOUNS.split()}
# A determiner with a noun is a subject ("The same engine for ..."); with any of these it is none.
DETERMINER = r"(?:all|another|any|both|each|most|one|others?|some|the (?:same|others?)|these|this)"
NO_NOUN = rf"(?:{'|'.join(sorted(LEANING - {'of'}))}|of (?:it|them|these|those))\b"
NOUNLESS = re.compile(rf"(?:{DETERMINER}(?:[.,:;]|$| {NO_NOUN})|the ones?\b|which (?:of|is|are)\b)")


def names_a_subject(line: str) -> bool:
    """Whether a first line begins with a noun or a verb of its own.

    A line in lower case is an equation or a list of values, as `before, after -> median error`.
    """
    first = re.match(r"[A-Z][a-z]*(?=[ ,.:;]|$)", line)
    if first is None:
        return True
    return first[0].lower() not in LEANING and not NOUNLESS.match(line[0].lower() + line[1:])


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yields line number and text of the docstrings of a module, its classes, functions, fields."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        statements = body if isinstance(body, list) else []
        opens = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        for before, statement in zip([None, *statements], statements, strict=False):
            documents = opens if before is None else isinstance(before, ast.Assign | ast.AnnAssign)
            match statement:
                case ast.Expr(value=ast.Constant(value=str(text))) if documents:
                    yield statement.lineno, text.strip()


def without_subject(source: str) -> list[str]:
    """`line number: first line` of each docstring that names no subject."""
    lines = [(number, text.partition("\n")[0]) for number, text in docstrings(ast.parse(source))]
    return [f"{number}: {line}" for number, line in lines if not names_a_subject(line)]


def test_every_docstring_names_its_subject():
    faults = [f"{file}:{line}" for file in FILES for line in without_subject(file.read_text())]
    assert faults == []


@pytest.mark.parametrize(
    "line",
    [
        "Of its settings, those of `Layout`.",
        "So many, of this place.",
        "Its package.",
        "As `diagnosis.json` has it.",
        "From commands to forces.",
        "Likewise.",
        "Where it lies.",
        "Those that differ.",
        "All of them.",
        "All that were fitted.",
        "The same in 0..255.",
        "The one of the best hypothesis, then the others.",
        "Which of them grow with the coefficient.",
        "One, or an array of them.",
    ],
)
def test_a_line_that_leans_on_its_signature_is_found(line):
    assert not names_a_subject(line)


@pytest.mark.parametrize(
    "line",
    [
        "Makes a joystick from settings: the fields of `PadLayout`.",
        "Share of the steps, [N].",
        "The same engine for another batch size.",
        "One of the filters.",
        "All stages of a study.",
        "Each of vx and vy within its bounds.",
        "None: the mean of left and right.",
        "What is driven: reference, mujoco, commonroad.",
        "Whether the loop has ended.",
        "On-board computer.",
        "behind' = max(0, behind - gap).",
        "before, after -> median distance [m].",
        "[T, 3] of the body frame.",
    ],
)
def test_a_line_with_a_subject_is_left_alone(line):
    assert names_a_subject(line)


def test_docstrings_of_every_kind_are_read():
    source = '''"""Of a module."""
LIMIT = 3
"""Of a constant."""
class Box:
    """Of a class."""
    side: float = 1.0
    """Of a field."""
    def volume(self):
        """Of a method."""
        self.known = True
        """Of an attribute."""
    async def opened(self):
        """Of a coroutine."""
"""Of nothing: no docstring."""
'''
    assert {line.split(" ", 1)[1] for line in without_subject(source)} == {
        "Of a module.",
        "Of a constant.",
        "Of a class.",
        "Of a field.",
        "Of a method.",
        "Of an attribute.",
        "Of a coroutine.",
    }
