"""examples/tour.ipynb runs from its first cell to its last, and its stored answers are those."""

import ast
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

EXAMPLES = Path(__file__).parents[1] / "examples"
TOUR = nbformat.read(EXAMPLES / "tour.ipynb", as_version=4)


def said(notebook):
    """What the cells have printed."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return "".join(o.text for cell in cells for o in cell.outputs if o.output_type == "stream")


@pytest.fixture(scope="module")
def executed():
    notebook = nbformat.from_dict(TOUR)
    NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(EXAMPLES)}}).execute()
    return notebook


def test_all_that_its_cells_import_is_there():
    code = "\n".join(cell.source for cell in TOUR.cells if cell.cell_type == "code")
    lines = "\n".join(
        line for line in code.splitlines() if not line.lstrip().startswith(("%", "!"))
    )
    imports = [n for n in ast.parse(lines).body if isinstance(n, (ast.Import, ast.ImportFrom))]
    assert any("buggy_rl" in ast.unparse(line) for line in imports)
    for line in imports:
        exec(ast.unparse(line), {})


@pytest.mark.slow
def test_the_tour_names_what_was_concealed_and_films_it(executed):
    assert "The steering takes effect" in said(executed)
    assert "[steering_dead_time, confidence 9" in said(executed)
    kinds = [o.data for c in executed.cells for o in c.get("outputs", []) if "data" in o]
    assert any("image/gif" in data for data in kinds)


@pytest.mark.slow
def test_its_stored_answer_is_the_one_it_gives(executed):
    number = r"takes effect (\d+)"
    assert re.findall(number, said(TOUR)) == re.findall(number, said(executed)) != []


def test_it_is_small_enough_to_be_read_online():
    assert (EXAMPLES / "tour.ipynb").stat().st_size < 500_000
