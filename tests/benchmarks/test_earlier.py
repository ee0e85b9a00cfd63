"""An earlier diagnosis beside the present one: both are counted alike, on the same cases."""

from dataclasses import asdict

from benchmarks.earlier import table

from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.ledger import Entry
from buggy_rl.proof.score.outcome import CaseAnswer, ScoredEffect

STACK = {
    "distance": {"as_given": 0.1, "stack": 0.02, "retuned": 0.09, "residual": 0.05},
    "farther": {name: (-1.0, 0.1) for name in ("as_given", "retuned", "residual")},
    "floor": 0.0,
}


def answer(*names):
    return CaseAnswer("missing_physics", tuple(ScoredEffect(name, 0.9) for name in names))


def entry(seed, *said, truth="wind"):
    concealed = {truth: {"along_x": 1.0}}
    weighed = {"strength": {truth: 20.0}, "stack": STACK}
    case = Case(seed, "reference", "reference", concealed=concealed)
    made = {"commit": "abcdef012345"}
    return Entry(
        case.id, "third", case, answers={"ours": answer(*said)}, weighed=weighed, made=made
    )


def line(own, distance=0.02):
    said = asdict(own.answers["ours"])
    return {"id": own.id, "commit": "012", "answer": said, "distance": distance}


def cells(text, name):
    [row] = [row for row in text.splitlines() if row.startswith(f"| {name}")]
    return [cell.strip() for cell in row.strip("|").split("|")]


def test_the_same_answers_have_the_same_figures():
    own = [entry(1, "wind"), entry(2, "payload"), entry(3)]
    found = table([(e, line(e)) for e in own])
    for row in found.splitlines()[2:]:
        _, first, second, _ = (cell.strip() for cell in row.strip("|").split("|"))
        assert first == second
    assert "cases exactly right (alone 0 : 0, p = 1)" in found


def test_other_answers_are_counted_beside_the_present_ones():
    own = [entry(1, "wind"), entry(2, "wind"), entry(3)]
    earlier = [line(entry(1, "payload"), 0.05), line(entry(2), 0.05), line(entry(3, "wind"), 0.05)]
    found = table([*zip(own, earlier, strict=True)])
    assert cells(found, "figure, 3 cases") == ["figure, 3 cases", "012", "abcdef0", "n"]
    named = cells(found, "effects above 6 nats that are named (")
    assert named == ["effects above 6 nats that are named (alone 1 : 2, p = 1)", "1", "2", "3"]
    assert cells(found, "cases without a wrong name")[1:] == ["2", "3", "3"]
    closed = cells(found, "gap closed on held-out drives, median")
    assert [c.split(" (")[0] for c in closed[1:3]] == ["50.0 %", "80.0 %"]
