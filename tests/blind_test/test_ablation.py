import json
from dataclasses import asdict
from pathlib import Path

import pytest

from buggy_rl.blind_test.ablation import RULES, AblationConfig, ablations, table
from buggy_rl.blind_test.case import Case
from buggy_rl.config import build
from buggy_rl.diagnosis.config import DEFAULTS, DiagnosisConfig
from buggy_rl.files import write_json

CASE = Case(1, "reference", "reference", False, {"viscous_drag": {"rate": 0.5}})


def answered(folder: Path, name: str | None, confidence: float = 0.9) -> None:
    """A diagnosis in its folder."""
    effects = [] if name is None else [{"name": name, "confidence": confidence}]
    write_json(folder / "diagnosis.json", {"verdict": "missing_physics", "effects": effects})
    write_json(folder / "outcome.json", {"status": "done", "seconds": 1.0, "last_words": ""})


@pytest.mark.parametrize("rule", RULES)
def test_a_rule_that_is_switched_off_is_another_number_of_the_same_field(rule):
    assert getattr(DEFAULTS, rule) != RULES[rule]
    options = ["simulator=x", "recordings=[y]", "output=z", f"selection.{rule}={RULES[rule]}"]
    asked = asdict(build(DiagnosisConfig, options).selection)
    assert {k for k, v in asdict(DEFAULTS).items() if asked[k] != v} == {rule}


def test_an_unknown_rule_is_refused_with_those_there_are():
    with pytest.raises(ValueError, match=r"no rules \['luck'\]; available: min_nats"):
        AblationConfig("proof", "output", ["luck"])


def test_what_each_rule_earns_is_counted(tmp_path, monkeypatch):
    config = AblationConfig(str(tmp_path / "p"), str(tmp_path / "a"), ["min_share"], [CASE.id])
    monkeypatch.setattr("buggy_rl.blind_test.sealing.CaseStore.cases", lambda self: [CASE])
    assert len(ablations(config, Path("diagnose.py"))) == 2
    answered(config.folder("as it is", CASE.id), "viscous_drag")
    answered(config.folder("min_share", CASE.id), "rolling_resistance")
    assert ablations(config, Path("diagnose.py")) == []
    rows = table(config).splitlines()
    assert rows[-2] == "| as it is | 1 | 1 | 0 | 0 |"
    assert rows[-1] == "| min_share | 0 | 0 | 1 | 1 |"
    assert json.loads((config.folder("min_share", CASE.id) / "outcome.json").read_text())
