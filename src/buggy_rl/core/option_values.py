"""Options of nested dataclasses: types, names, what a text means as a value, lines of `--help`.

A text option is taken as it stands, so that a file's name may have any character. Brackets about a
list may be left out, which shells need: `recordings=drives`, `seeds=0,1`, `effects=[payload,wind]`.
`--help` reads the dataclass's source instead of importing it, so it answers without torch.
"""

import ast
import dataclasses
import difflib
import importlib.util
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import yaml

QUOTED = re.compile(r"""\s*('(?:[^']|'')*'|"(?:[^"\\]|\\.)*")\s*(?:,|$)""")
LISTS = list, tuple


def option_type(cls: Any, key: str) -> Any:
    """Type of an option of a dataclass, of nested ones `a.b`; None where it has no such option."""
    for part in key.split("."):
        cls = _some(cls)
        if dataclasses.is_dataclass(cls):
            cls = get_type_hints(cls).get(part)
        else:
            cls = get_args(cls)[1] if get_origin(cls) is dict and get_args(cls) else None
    return cls


def _some(kind: Any) -> Any:
    """The type of a value that is not None, of an optional one."""
    if get_origin(kind) in (Union, UnionType):
        others = [k for k in get_args(kind) if k is not NoneType]
        return others[0] if len(others) == 1 else None
    return kind


def is_list(kind: Any) -> bool:
    """Whether a type is that of a list."""
    return get_origin(_some(kind)) in LISTS


def is_text(kind: Any) -> bool:
    """Whether a type is that of a text."""
    return _some(kind) is str


def text_of(kind: Any, text: str) -> str | None:
    """A text option: as written, or within quotes; `null` is None where there may be none."""
    if text == "null" and kind is not str:
        return None
    quoted = QUOTED.fullmatch(text)
    return str(yaml.safe_load(quoted[1])) if quoted and not text.endswith(",") else text


def list_of(kind: Any, text: str) -> Any:
    """A list option, with or without brackets, its items between commas.

    A text that is the name of a file is one item, whatever its characters.

    Raises:
        ValueError: A bracket is not closed, or a file's name with a comma is not in quotes.
    """
    if text.startswith("${"):
        return text
    if get_args(_some(kind))[:1] != (str,):
        return yaml.safe_load(text if text.startswith("[") else f"[{text}]")
    if os.path.exists(text):
        return [text]
    if text.startswith("["):
        if not text.endswith("]"):
            raise ValueError(
                f"no ] at the end of {text!r}: put the whole option in quotes where a name has a "
                "space, 'key=[one, two]'"
            )
        text = text[1:-1]
        if os.path.exists(text):
            return [text]
    places = list(_items(text))
    _refuse_split_names(text, places)
    return [text_of(str, text[start:end].strip()) for start, end in places]


def _items(text: str) -> Iterator[tuple[int, int]]:
    """Start and end of each item that is not empty, between commas outside of quotes and []."""
    start, at, depth = 0, 0, 0
    balanced = text.count("[") == text.count("]")
    while at < len(text):
        quoted = QUOTED.match(text, at) if at == start else None
        if quoted:
            yield start, quoted.end(1)
            at = start = quoted.end()
            continue
        depth += (text[at] == "[") - (text[at] == "]") if balanced else 0
        if text[at] == "," and not depth:
            if text[start:at].strip():
                yield start, at
            start = at + 1
        at += 1
    if text[start:].strip():
        yield start, len(text)


def _refuse_split_names(text: str, places: list[tuple[int, int]]) -> None:
    """Refuses items that are parts of one file's name."""
    there = [os.path.exists(text[start:end].strip()) for start, end in places]
    for first in range(len(places)):
        for last in range(first + 1, len(places)):
            name = text[places[first][0] : places[last][1]].strip()
            if not all(there[first : last + 1]) and os.path.exists(name):
                raise ValueError(
                    f"the file {name!r} has a comma in its name: put it in quotes within the "
                    f"""list, 'key=["{name}"]'"""
                )


def nearest(name: str, known: Iterable[str]) -> str:
    """`did you mean ...? ` of the known name that is most alike; empty where none is."""
    close = difflib.get_close_matches(name, list(known), 1)
    return f"did you mean {close[0]!r}? " if close else ""


def option_names(cls: Any, prefix: str = "") -> Iterator[str]:
    """Dotted names of all options of a dataclass, those of nested ones too."""
    for name, kind in get_type_hints(cls).items():
        inner = _some(kind)
        if dataclasses.is_dataclass(inner):
            yield from option_names(inner, f"{prefix}{name}.")
        else:
            yield prefix + name


def describe(schema: str, prefix: str = "") -> Iterator[str]:
    """One line for each option of a dataclass: key, default, what it means. Imports nothing."""
    module, _, name = schema.partition(":")
    tree = _source(module)
    origins, classes = _imported(tree), _classes(tree)
    if name not in classes:
        raise ValueError(f"{module} defines no class {name}")
    body = classes[name].body
    own = {prefix + ast.unparse(node.target) for node in body if isinstance(node, ast.AnnAssign)}
    for base in map(ast.unparse, classes[name].bases):
        inherited = f"{module}:{base}" if base in classes else _home(origins.get(base, ""))
        if inherited:
            lines = describe(inherited, prefix)
            yield from (line for line in lines if _key(line) not in own)
    for node, after in zip(body, [*body[1:], None], strict=True):
        if not isinstance(node, ast.AnnAssign) or not isinstance(node.target, ast.Name):
            continue
        key, kind = prefix + node.target.id, ast.unparse(node.annotation)
        if kind.startswith("dict[str, "):  # options of each entry, under a name of one's own
            inner = kind.removeprefix("dict[str, ").rstrip("]")
            if inner in classes or _home(origins.get(inner, "")):
                key, kind = f"{key}.NAME", inner
        nested = f"{module}:{kind}" if kind in classes else _home(origins.get(kind, ""))
        if nested:
            yield from describe(nested, f"{key}.")
            continue
        default = "(needed)" if node.value is None else _default(node.value)
        yield f"  {key}={default}\n      {_docline(after)}".rstrip()


def _key(line: str) -> str:
    """The option that a line of `describe` is about."""
    return line.strip().partition("=")[0]


def _source(module: str) -> ast.Module:
    # `find_spec` of a submodule imports its parents; ours import nothing heavy.
    spec = importlib.util.find_spec(module)
    if spec is None or spec.origin is None:
        raise ValueError(f"there is no module {module}")
    return ast.parse(Path(spec.origin).read_text())


def _imported(tree: ast.Module) -> dict[str, str]:
    """What a module imports by name, also for the type checker only: name -> `module:name`."""
    return {
        alias.asname or alias.name: f"{node.module}:{alias.name}"
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }


def _classes(tree: ast.Module) -> dict[str, ast.ClassDef]:
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}


def _home(name: str) -> str:
    """The `module:Class` itself if the class is ours, else ""."""
    module, _, attribute = name.partition(":")
    ours = module.startswith("buggy_rl.") and attribute in _classes(_source(module))
    return name if ours else ""


def _default(value: ast.expr) -> str:
    if isinstance(value, ast.Call):  # field(default_factory=lambda: [...])
        for keyword in value.keywords:
            if keyword.arg == "default_factory":
                factory = keyword.value
                body = factory.body if isinstance(factory, ast.Lambda) else factory
                return {"list": "[]", "dict": "{}"}.get(ast.unparse(body), ast.unparse(body))
    text = ast.unparse(value)
    return "(needed)" if text == "MISSING" else text


def _docline(node: ast.stmt | None) -> str:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return " ".join(str(node.value.value).split())
    return ""
