"""Mutation testing of estimation, effects and diagnosis: which changed lines do no tests notice?

    python benchmarks/mutants.py samples=100 seed=0
    python benchmarks/mutants.py "folders=[estimation]" samples=20 timeout=300

Each sample is one changed operator, number, truth value or function of one line, in a copy of the
package that stands first on PYTHONPATH. Tests of its module run first, then the others of
its folder. A mutant is killed if a test fails. Results are appended to the output as JSON lines;
run again with the same options, what is there is not repeated. All tests must pass before.
"""

import ast
import difflib
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from pathlib import Path

from tqdm import tqdm

from buggy_rl.core.config import from_command_line

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "buggy_rl"
TESTS = {  # folder of a module -> tests nearest to it, the longest match first
    "diagnosis/report": ("tests/diagnosis/test_report.py",),
    "diagnosis": ("tests/diagnosis",),
    "estimation": ("tests/estimation",),
    "effects": ("tests/effects", "tests/contracts/test_effects.py"),
}
ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "PASSIVE",
    "PYTHONDONTWRITEBYTECODE": "1",
}
OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    **{ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt},
    **{ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.In: ast.NotIn, ast.NotIn: ast.In},
    **{ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.And: ast.Or, ast.Or: ast.And},
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult},
    **{ast.Pow: ast.Mult, ast.FloorDiv: ast.Div, ast.BitAnd: ast.BitOr},
}
PAIRS = (
    *(("min", "max"), ("minimum", "maximum"), ("clamp_min", "clamp_max"), ("amin", "amax")),
    *(("argmin", "argmax"), ("any", "all"), ("sum", "mean"), ("cos", "sin"), ("square", "abs")),
)
FUNCTIONS = dict(PAIRS) | {b: a for a, b in PAIRS}
# Texts and types change no number; positions within f-strings are not known.
SKIPPED = (ast.JoinedStr, ast.Raise, ast.Assert, ast.Import, ast.ImportFrom)


@dataclass(frozen=True)
class Config:
    """Which mutants to try."""

    folders: list[str] = field(default_factory=lambda: ["estimation", "effects", "diagnosis"])
    """Folders of the package."""
    samples: int = 100
    """Lines, one mutant each."""
    seed: int = 0
    """Of the sample."""
    timeout: float = 900.0
    """[s] of one run of tests, after which a mutant counts as timed out."""
    output: str = "runs/mutants.jsonl"
    """JSON lines, appended."""


@dataclass(frozen=True)
class Mutant:
    """A change of one expression."""

    file: str
    """In the package."""
    line: int
    diff: str
    """Unified, without context."""
    text: str
    """Of the whole file, changed."""


def main() -> None:
    """Tries what is not in the output yet, and prints what survived."""
    config = from_command_line(__doc__, "mutants:Config")
    output = Path(config.output)
    output.parent.mkdir(parents=True, exist_ok=True)
    known = read(output)
    chosen = sample(config)
    todo = [mutant for mutant in chosen if key(asdict(mutant)) not in known]
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(SOURCE, Path(folder) / "buggy_rl")
        with tqdm(todo, "mutants", unit="mutant") as shown:
            for mutant in shown:
                shown.set_postfix_str(f"{mutant.file}:{mutant.line}")
                row = {"file": mutant.file, "line": mutant.line, "diff": mutant.diff}
                row["result"] = tried(mutant, Path(folder), config.timeout)
                known[key(row)] = row
                with output.open("a") as lines:
                    lines.write(json.dumps(row) + "\n")
    print(summary([known[key(asdict(mutant))] for mutant in chosen]))


def read(output: Path) -> dict[tuple[str, str], dict]:
    """Results so far."""
    if not output.exists():
        return {}
    rows = [json.loads(line) for line in output.read_text().splitlines()]
    return {key(row): row for row in rows}


def key(row: dict) -> tuple[str, str]:
    """By which a mutant is known again: the diff begins with its lines' numbers."""
    return row["file"], row["diff"]


def summary(rows: list[dict]) -> str:
    """How many were killed, and the diffs of the others."""
    counts = Counter(row["result"] for row in rows)
    said = ", ".join(f"{count} {result}" for result, count in counts.most_common())
    others = [r for r in rows if r["result"] != "killed"]
    lines = [f"{r['result']}: {r['file']}:{r['line']}\n{r['diff']}" for r in others]
    return "\n\n".join([f"{len(rows)} mutants: {said or 'none'}", *lines])


def sample(config: Config) -> list[Mutant]:
    """One mutant each of lines drawn from all that can be changed; same seed, same sample."""
    lines: dict[tuple[str, int], list[Mutant]] = defaultdict(list)
    for folder in config.folders:
        for path in sorted((SOURCE / folder).rglob("*.py")):
            name = path.relative_to(SOURCE).as_posix()
            for mutant in mutants(name, path.read_text()):
                lines[mutant.file, mutant.line].append(mutant)
    draw = random.Random(config.seed)
    chosen = draw.sample(sorted(lines), min(config.samples, len(lines)))
    return [draw.choice(lines[line]) for line in chosen]


def mutants(file: str, text: str) -> Iterator[Mutant]:
    """All of a file."""
    for node, decides in changeable(ast.parse(text)):
        for changed in changes(node, decides):
            whole = spliced(text, node, changed)
            yield Mutant(file, node.lineno, difference(text, whole), whole)


def changeable(node: ast.AST, returns: str = "") -> Iterator[tuple[ast.expr, bool]]:
    """Expressions that compute something, and whether each is a condition or a returned bool.

    Args:
        node: What they are in.
        returns: Type that the function around it returns.
    """
    if isinstance(node, ast.FunctionDef):
        returns = ast.unparse(node.returns) if node.returns else ""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(child, SKIPPED):
                continue
            if isinstance(child, ast.expr):
                yield child, name == "test" or (isinstance(node, ast.Return) and returns == "bool")
            yield from changeable(child, returns)


def changes(node: ast.expr, decides: bool) -> Iterator[str]:
    """What an expression may be replaced with."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in OPERATORS:
        yield _with(node, ops=[OPERATORS[type(node.ops[0])]()])
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield f"({ast.unparse(node.operand)})"
    elif decides:
        yield f"(not ({ast.unparse(node)}))"
    if isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in OPERATORS:
        yield _with(node, op=OPERATORS[type(node.op)]())
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield repr(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield repr(2 * node.value or 1)
    elif isinstance(node, ast.Call):
        function = node.func
        if isinstance(function, ast.Name) and function.id in FUNCTIONS:
            yield _with(node, func=ast.Name(FUNCTIONS[function.id]))
        elif isinstance(function, ast.Attribute) and function.attr in FUNCTIONS:
            yield _with(node, func=ast.Attribute(function.value, FUNCTIONS[function.attr]))


def _with(node: ast.expr, **fields) -> str:
    copy = deepcopy(node)
    for name, value in fields.items():
        setattr(copy, name, value)
    return f"({ast.unparse(copy)})"


def spliced(text: str, node: ast.expr, changed: str) -> str:
    """The text with another expression in the place of one; columns are bytes."""
    lines = text.encode().splitlines(keepends=True)
    assert node.end_lineno is not None
    before = b"".join(lines[: node.lineno - 1]) + lines[node.lineno - 1][: node.col_offset]
    last = lines[node.end_lineno - 1][node.end_col_offset :]
    return (before + changed.encode() + last + b"".join(lines[node.end_lineno :])).decode()


def difference(text: str, changed: str) -> str:
    """The lines that differ, with their numbers."""
    lines = difflib.unified_diff(text.splitlines(), changed.splitlines(), n=0, lineterm="")
    return "\n".join(list(lines)[2:])


def tried(mutant: Mutant, folder: Path, timeout: float) -> str:
    """Runs the nearest tests on a mutant: killed, survived or timed out."""
    path = folder / "buggy_rl" / mutant.file
    path.write_text(mutant.text)
    try:
        for arguments in runs(mutant.file):
            result = outcome(arguments, folder, timeout)
            if result != "survived":
                return result
        return "survived"
    finally:
        shutil.copy2(SOURCE / mutant.file, path)


def runs(file: str) -> Iterator[list[str]]:
    """Arguments of pytest: the tests of the module, then what else is near."""
    near = next(tests for folder, tests in TESTS.items() if file.startswith(f"{folder}/"))
    names = [f"{near[0]}/test_{name}.py" for name in (Path(file).stem, Path(file).parent.name)]
    own = [name for name in names if (ROOT / name).exists()]
    if own:
        yield own
    yield [*near, *(f"--ignore={name}" for name in own)]


def outcome(arguments: list[str], folder: Path, timeout: float) -> str:
    """Of one run of pytest."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *arguments]
    paths = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    environment = {**os.environ, **ENVIRONMENT, "PYTHONPATH": paths}
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, timeout=timeout, check=False
        )
    except subprocess.TimeoutExpired:
        return "timed out"
    if done.returncode not in (0, 1, 2):  # 1: a test failed, 2: it could not be imported
        raise SystemExit(f"error: {' '.join(command)}: {done.stdout.decode().strip()[-500:]}")
    return "killed" if done.returncode else "survived"


if __name__ == "__main__":
    main()
