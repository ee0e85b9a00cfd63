"""Mutation testing: which changes it makes, which tests it runs, what it remembers."""

import importlib
import json

import pytest

SOURCE = '''"""Docs with 1 number."""

LIMIT = 2.0  # [m]


def within(x: int = 0, far: bool = False) -> bool:
    if far:
        raise ValueError(f"{x - 1} is far")
    return x < LIMIT
'''


@pytest.fixture(scope="module")
def mutants(request):
    """Imports the script from its folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(request.config.rootpath / "benchmarks")
        yield importlib.import_module("mutants")


def changed_lines(mutants, text):
    return [m.diff.splitlines()[-1] for m in mutants.mutants("a.py", text)]


def test_numbers_conditions_and_returned_comparisons_change_and_texts_do_not(mutants):
    assert sorted(changed_lines(mutants, SOURCE)) == sorted(
        [
            "+LIMIT = 4.0  # [m]",
            "+def within(x: int = 1, far: bool = False) -> bool:",
            "+def within(x: int = 0, far: bool = True) -> bool:",
            "+    if (not (far)):",
            "+    return (x >= LIMIT)",
        ]
    )


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("a + b", ["(a - b)"]),
        ("a * b", ["(a / b)"]),
        ("not a", ["(a)"]),
        ("a and b", ["(a or b)"]),
        ("max(a, b)", ["(min(a, b))"]),
        ("a.clamp_min(b)", ["(a.clamp_max(b))"]),
        ("'µ' + -a", ["('µ' - -a)", "'µ' + (a)"]),
    ],
)
def test_an_expression_changes_in_its_own_place(mutants, line, expected):
    assert changed_lines(mutants, f"y = {line}\n") == [f"+y = {e}" for e in expected]


def test_the_same_seed_draws_the_same_lines_once_each(mutants):
    config = mutants.Config(samples=20, seed=1, folders=["estimation"])
    drawn = [(m.file, m.line) for m in mutants.sample(config)]
    assert drawn == [(m.file, m.line) for m in mutants.sample(config)]
    assert len(set(drawn)) == 20


def test_the_tests_of_a_module_run_before_the_others_of_its_folder(mutants):
    first, others = mutants.runs("diagnosis/search/joint.py")
    assert first == ["tests/diagnosis/test_joint.py"]
    assert others == ["tests/diagnosis", "--ignore=tests/diagnosis/test_joint.py"]
    first, others = mutants.runs("effects/motion/yaw.py")
    assert first == ["tests/effects/test_motion.py"]
    assert "tests/contracts/test_effects.py" in others


def test_what_the_output_holds_is_not_tried_again(mutants, tmp_path, monkeypatch, capsys):
    output = tmp_path / "mutants.jsonl"
    options = ["samples=3", "folders=[estimation]", f"output={output}"]
    monkeypatch.setattr(mutants.sys, "argv", ["mutants.py", *options])
    tried = []
    monkeypatch.setattr(mutants, "tried", lambda *given: tried.append(given) or "survived")
    mutants.main()
    mutants.main()
    rows = [json.loads(line) for line in output.read_text().splitlines()]
    assert len(rows) == len(tried) == 3
    assert set(rows[0]) == {"file", "line", "diff", "result"}
    assert "3 mutants: 3 survived" in capsys.readouterr().out
