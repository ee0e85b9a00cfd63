"""Counts what the structure of the package is judged by: files, cycles, loops, thresholds, lengths.

python benchmarks/structure.py
python benchmarks/structure.py path/to/another/checkout/src/buggy_rl
"""

import ast
import sys
from pathlib import Path

LONG, MANY = 60, 6  # lines of a function, parameters of a signature
DECIDING = ("diagnosis", "estimation")  # packages whose thresholds are counted
CODE = (ast.FunctionDef, ast.AsyncFunctionDef)


def main() -> None:
    """Prints one line a figure."""
    if {"-h", "--help"} & set(sys.argv):
        raise SystemExit(__doc__)
    default = Path(__file__).parents[1] / "src" / "buggy_rl"
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    trees = {file: ast.parse(file.read_text()) for file in sorted(root.rglob("*.py"))}
    functions = [
        node for tree in trees.values() for node in ast.walk(tree) if isinstance(node, CODE)
    ]
    lines = sum(len(file.read_text().splitlines()) for file in trees)
    figures = {
        "files": len(trees),
        "lines": lines,
        "flat modules": sum(f.parent == root and f.name != "__init__.py" for f in trees),
        "packages in an import cycle": len(cyclic(root, trees)),
        "numeric module constants of the diagnosis": sum(
            constants(tree) for file, tree in trees.items() if deciding(root, file)
        ),
        "loops that step an environment": sum(loops(tree) for tree in trees.values()),
        f"functions over {LONG} lines": sum(length(f) > LONG for f in functions),
        f"signatures over {MANY} parameters": sum(parameters(f) > MANY for f in functions),
    }
    for name, value in figures.items():
        print(f"{value:>6} {name}")


def length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of a function."""
    return (function.end_lineno or function.lineno) - function.lineno + 1


def deciding(root: Path, file: Path) -> bool:
    """Whether a module's thresholds decide an answer; also where they lay before."""
    return file.relative_to(root).parts[0] in DECIDING and "report" not in file.parts


def constants(tree: ast.Module) -> int:
    """Module-level names in capitals that hold a number, or a tuple of numbers."""
    return sum(
        isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Name)
        and node.targets[0].id.isupper()
        and any(
            isinstance(part, ast.Constant) and isinstance(part.value, (int, float))
            for part in ast.walk(node.value)
        )
        for node in tree.body
    )


def loops(tree: ast.Module) -> int:
    """`for` and `while` loops that call `.step(...)` of an environment."""
    return sum(
        isinstance(loop, (ast.For, ast.While))
        and any(
            isinstance(call, ast.Call)
            and isinstance(call.func, ast.Attribute)
            and call.func.attr == "step"
            and call.args
            for call in ast.walk(loop)
        )
        for loop in ast.walk(tree)
    )


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Of a signature, without `self` and `cls`."""
    own = function.args
    names = [a.arg for a in (*own.posonlyargs, *own.args, *own.kwonlyargs)]
    return len([name for name in names if name not in ("self", "cls")])


def cyclic(root: Path, trees: dict[Path, ast.Module]) -> set[str]:
    """Top-level parts of the package that import themselves by way of others."""
    graph: dict[str, set[str]] = {}
    for file, tree in trees.items():
        part = file.relative_to(root).with_suffix("").parts[0]
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("buggy_rl."):
                graph.setdefault(part, set()).add(str(node.module).split(".")[1])

    def reached(part: str) -> set[str]:
        seen: set[str] = set()
        left = list(graph.get(part, set()) - {part})
        while left:
            other = left.pop()
            if other not in seen:
                seen.add(other)
                left += graph.get(other, set()) - {other}
        return seen

    return {part for part in graph if part in reached(part)}


if __name__ == "__main__":
    main()
