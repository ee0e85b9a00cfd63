"""The runtime is Python 3.6: its grammar, its standard library, annotations too."""

import ast
import io
import tokenize
from itertools import pairwise
from pathlib import Path

import pytest

CAR = Path(__file__).parents[2] / "src" / "buggy_rl" / "car"
FILES = [CAR.parent / "__init__.py", *sorted(CAR.rglob("*.py"))]

NEWER_MODULES = {  # standard library of 3.7 and later
    "dataclasses", "contextvars", "importlib.resources", "importlib.metadata", "graphlib",
    "zoneinfo", "tomllib", "multiprocessing.shared_memory",
}  # fmt: skip
NEWER_NAMES = {  # module -> what came after 3.6
    "typing": {
        "Protocol", "Literal", "Final", "TypedDict", "runtime_checkable", "final", "Annotated",
        "Self", "ForwardRef", "SupportsIndex", "get_origin", "get_args", "TypeAlias",
        "ParamSpec", "NotRequired", "Required", "override", "assert_never", "OrderedDict",
    },
    "contextlib": {"nullcontext", "aclosing", "AsyncExitStack", "asynccontextmanager", "chdir"},
    "functools": {"cache", "cached_property", "singledispatchmethod"},
    "itertools": {"pairwise", "batched"},
    "math": {"dist", "prod", "comb", "perm", "isqrt", "lcm", "nextafter", "ulp", "cbrt", "exp2"},
    "time": {
        "monotonic_ns", "time_ns", "perf_counter_ns", "process_time_ns", "thread_time",
        "CLOCK_UPTIME_RAW",
    },
    "signal": {"raise_signal", "valid_signals", "strsignal", "pidfd_send_signal"},
    "socket": {"create_server", "has_dualstack_ipv6", "send_fds", "recv_fds"},
    "asyncio": {"run", "create_task", "to_thread", "Runner", "TaskGroup", "current_task"},
    "os": {"pidfd_open", "register_at_fork", "waitstatus_to_exitcode", "memfd_create"},
    "shlex": {"join"},
    "statistics": {"fmean", "quantiles", "geometric_mean", "NormalDist", "multimode"},
    "threading": {"excepthook", "get_native_id", "ExceptHookArgs"},
    "queue": {"SimpleQueue"},
    "ast": {"unparse"},
    "random": {"randbytes"},
}  # fmt: skip
NEWER_METHODS = {"removeprefix", "removesuffix", "is_relative_to", "bit_count", "readlink"}
NEWER_ARGUMENTS = {  # function -> keywords that came after 3.6
    "run": {"capture_output", "text"},
    "Popen": {"text", "user", "process_group"},
    "unlink": {"missing_ok"},
    "zip": {"strict"},
    "copytree": {"dirs_exist_ok"},
    "namedtuple": {"defaults"},
    "accumulate": {"initial"},
}
BUILTIN_GENERICS = {"list", "dict", "tuple", "set", "frozenset", "type", "deque", "defaultdict"}


def faults(source):
    """What a source holds that Python 3.6 does not."""
    try:
        tree = ast.parse(source, feature_version=(3, 6))
    except SyntaxError as error:
        return [f"grammar: {error.msg}"]
    return [*_string_faults(source), *(f for node in ast.walk(tree) for f in _node_faults(node))]


def _string_faults(source):
    """`{a=}` in an f-string: the parser of 3.12 takes it for 3.6 too, but its tokens tell."""
    tokens = [t.string for t in tokenize.generate_tokens(io.StringIO(source).readline)]
    if any(one == "=" and other in ("}", "!", ":") for one, other in pairwise(tokens)):
        yield "f-string with {name=}"


def _node_faults(node):
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names if alias.name in NEWER_MODULES)
    if isinstance(node, ast.ImportFrom):
        names = {alias.name for alias in node.names}
        if node.module in NEWER_MODULES:
            yield node.module
        if node.module == "__future__" and "annotations" in names:
            yield "from __future__ import annotations"
        yield from sorted(names & NEWER_NAMES.get(node.module, set()))
        yield from (f"{node.module}.{n}" for n in names if f"{node.module}.{n}" in NEWER_MODULES)
    if isinstance(node, ast.Attribute):
        owner = node.value.id if isinstance(node.value, ast.Name) else ""
        if node.attr in NEWER_NAMES.get(owner, set()) or node.attr in NEWER_METHODS:
            yield f"{owner}.{node.attr}"
    if isinstance(node, ast.Call):
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        given = {keyword.arg for keyword in node.keywords}
        yield from (f"{name}({k}=)" for k in sorted(given & NEWER_ARGUMENTS.get(name, set())))
        if name == "hypot" and len(node.args) > 2:
            yield "hypot of more than two numbers"
        if name == "breakpoint":
            yield name
    if isinstance(node, ast.Subscript) and getattr(node.value, "id", "") in BUILTIN_GENERICS:
        yield f"{node.value.id}[...]: write typing's"
    if isinstance(node, ast.FunctionDef | ast.AnnAssign | ast.arg):
        yield from _union_faults(node)
    if isinstance(node, ast.FunctionDef) and node.name == "__getattr__" and node.col_offset == 0:
        yield "__getattr__ of a module"


def _union_faults(node):
    """`X | Y` in an annotation, which Python 3.6 evaluates and refuses."""
    notes = [getattr(node, "annotation", None), getattr(node, "returns", None)]
    for note in notes:
        for part in ast.walk(note) if note is not None else ():
            if isinstance(part, ast.BinOp) and isinstance(part.op, ast.BitOr):
                yield "X | Y in an annotation"


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.relative_to(CAR.parent).as_posix())
def test_a_file_of_the_runtime_is_python_36(file):
    # Python 3.6 never calls the package's lazy names: on the car nothing asks for them.
    lazy = ["__getattr__ of a module"] if file.parent == CAR.parent else []
    assert faults(file.read_text()) == lazy


@pytest.mark.parametrize(
    "line",
    [
        "if (n := 1): pass",
        "def f(a, /): pass",
        "x = f'{a=}'",
        "with (open('a') as a, open('b') as b): pass",
        "match x:\n    case 1: pass",
        "from __future__ import annotations",
        "from dataclasses import dataclass",
        "import dataclasses",
        "from typing import Protocol",
        "import typing\nx: typing.Literal[1] = 1",
        "def f(a: list[int]): pass",
        "def f(a: int | None): pass",
        "def f() -> int | None: pass",
        "x: dict[str, int] = {}",
        "'ab'.removeprefix('a')",
        "subprocess.run(['ls'], capture_output=True)",
        "path.unlink(missing_ok=True)",
        "zip(a, b, strict=True)",
        "import time\ntime.monotonic_ns()",
        "from contextlib import nullcontext",
        "math.hypot(1, 2, 3)",
        "from importlib import resources",
        "try:\n    pass\nexcept* ValueError:\n    pass",
        "async def f():\n    return [x async for x in y]\nbreakpoint()",
    ],
)
def test_a_newer_feature_is_found(line):
    assert faults(line)


@pytest.mark.parametrize(
    "line",
    [
        "x: int = 1\ny = f'{x:.2f}'",
        "from typing import NamedTuple, List\nclass A(NamedTuple):\n    a: List[int] = []",
        "import math\nmath.hypot(1, 2)",
        "flags = A | B\nlist(x)[0]",
    ],
)
def test_python_36_is_let_through(line):
    assert faults(line) == []


def test_the_files_are_found():
    assert {"policy.py", "path.py", "policy_file.py"} <= {file.name for file in FILES}
