"""Files that a result reads: those that a setting names, and what they name or import in turn.

A simulator is a file that names files: effects and models in YAML, meshes in XML, modules of the
user's own in Python. Nothing is imported to find them. Our own package and installed ones are left
out.
"""

import ast
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any

import yaml

# Endings of files that code reads; one of another ending may be a file that it writes.
READ = {
    *(".py", ".yaml", ".yml", ".json", ".toml", ".xml", ".urdf", ".txt"),
    *(".pt", ".pth", ".onnx", ".npz", ".npy", ".csv", ".parquet", ".pkl", ".stl", ".obj"),
}
INSTALLED = {"site-packages", "dist-packages"}
OURS = Path(__file__).parents[1]
LONGEST = 1000  # characters of a file's name


def spec_of(top: str) -> ModuleSpec | None:
    """The spec of a top-level module, which is not imported.

    As `importlib.util.find_spec`, but without the finder of setuptools: when that is asked for
    `pip` it stops working for the rest of the process, and setuptools cannot be imported any more.
    """
    if top in sys.modules:
        return sys.modules[top].__spec__
    finders = [f for f in sys.meta_path if type(f).__module__ != "_distutils_hack"]
    return next((s for s in (f.find_spec(top, None) for f in finders) if s is not None), None)


def files_read(named: str) -> list[Path]:
    """Files behind a name, with those that they name or import in turn; the first is its own.

    Args:
        named: A file, `path/to/file.py:attribute` or `package.module:attribute`; of anything else
            there are none.
    """
    found: dict[Path, None] = {}
    waiting = list(_named(named, [Path.cwd()]))
    while waiting:
        file = waiting.pop(0)
        if file not in found:
            found[file] = None
            waiting += [other for other in _behind(file) if other not in found]
    return list(found)


def _named(name: str, folders: Sequence[Path]) -> Iterator[Path]:
    """The file that a name in a file of one of the folders stands for."""
    if not 0 < len(name) < LONGEST or "\n" in name or "\0" in name:
        return
    place = name.rpartition(":")[0] or name
    for folder in folders:
        for file in (folder / name, folder / place):
            if file.suffix.lower() in READ and _is_file(file):
                yield file.resolve()
                return
    if ":" in name and re.fullmatch(r"[A-Za-z_][\w.]*", place):
        yield from _modules(place, [])


def _is_file(file: Path) -> bool:
    try:
        return file.is_file()
    except OSError:  # a text that is no name of a file
        return False


def _behind(file: Path) -> Iterator[Path]:
    """Files that a file names or imports; of our own package there are none."""
    if file.is_relative_to(OURS):
        return
    kind, folders = file.suffix.lower(), [file.parent, Path.cwd()]
    if kind == ".py":
        yield from _behind_code(file)
    elif kind in (".yaml", ".yml"):
        for text in _texts_of(file):
            yield from _named(text, folders)
    elif kind in (".xml", ".urdf"):
        for text in re.findall(r"""["']([^"'<>\n]+)["']""", file.read_text(errors="replace")):
            yield from _named(text, folders)


def _texts_of(file: Path) -> Iterator[str]:
    try:
        return _texts(yaml.safe_load(file.read_text()))
    except (yaml.YAMLError, UnicodeDecodeError):  # whoever reads it says so
        return iter(())


def _texts(content: Any) -> Iterator[str]:
    if isinstance(content, Mapping):
        for name, value in content.items():
            yield from _texts(name)
            yield from _texts(value)
    elif isinstance(content, list):
        for value in content:
            yield from _texts(value)
    elif isinstance(content, str):
        yield content


def _behind_code(file: Path) -> Iterator[Path]:
    """Modules of the user's own that a Python file imports, and files that its texts name."""
    try:
        tree = ast.parse(file.read_bytes())
    except SyntaxError:  # whoever runs it says so
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from _modules(alias.name, [file.parent])
        elif isinstance(node, ast.ImportFrom):
            yield from _imported_from(node, file)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from _named(node.value, [file.parent, Path.cwd()])
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            for argument in node.args[:1]:
                if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
                    yield from _modules(argument.value.lstrip("."), [file.parent])


def _imported_from(node: ast.ImportFrom, file: Path) -> Iterator[Path]:
    names = [node.module] if node.module else []
    names += [f"{node.module}.{a.name}" if node.module else a.name for a in node.names]
    folder = file.parent
    for _ in range(node.level - 1):
        folder = folder.parent
    for name in names:
        if node.level:
            yield from _files_of(name.split("."), [folder])
        else:
            yield from _modules(name, [file.parent])


def _modules(name: str, folders: Sequence[Path]) -> Iterator[Path]:
    """Files of a module and of the packages that it is in, if it is the user's own."""
    top = name.partition(".")[0]
    if top == "buggy_rl":
        return
    found = list(_files_of(name.split("."), folders))
    if not found and top not in sys.stdlib_module_names:
        try:
            spec = spec_of(top)
        except (ImportError, ValueError):
            spec = None
        places = [*(spec.submodule_search_locations or ()), spec.origin] if spec else []
        homes = [Path(place).parent for place in places if place]
        own = [home for home in homes if not INSTALLED & set(home.parts)]
        found = list(_files_of(name.split("."), own))
    yield from found


def _files_of(parts: Sequence[str], folders: Sequence[Path]) -> Iterator[Path]:
    for folder in folders:
        found, place = [], folder
        for part in parts:
            package, module = place / part / "__init__.py", place / f"{part}.py"
            found += [file.resolve() for file in (package, module) if _is_file(file)][:1]
            place = place / part
        if found and not INSTALLED & set(found[0].parts):
            yield from found
            return
