"""Answers counted by pairing of car and simulator."""

from buggy_rl.diagnosis.search.posterior import Posterior
from buggy_rl.proof.calibrate.named import by_pairing
from buggy_rl.proof.plants.composed import SORTS
from tests.diagnosis.observations import hypothesis
from tests.proof.test_calibration import entry

HYPOTHESES = [hypothesis(e, [10.0, 10.0], 0.5) for e in ((), ("payload",), ("wind",))]
SURE = Posterior({(): 0.1, ("payload",): 0.9}, 0.0)
UNSURE = Posterior({(): 0.1, ("payload",): 0.3}, 0.6)


def test_each_pairing_has_a_row_with_what_is_right_of_how_many():
    cases = [
        entry(0, ["payload"], HYPOTHESES),  # seeds 0 and 3 are of one plant
        entry(3, ["wind"], HYPOTHESES),
        entry(1, [SORTS[0]], HYPOTHESES),
        entry(4, [SORTS[0]], HYPOTHESES),
        entry(2, [], HYPOTHESES),
    ]
    rows = by_pairing(cases, [SURE, SURE, UNSURE, SURE, SURE]).splitlines()[2:]
    assert rows == [
        "| commonroad -> reference, baseline |  |  |  | 0 of 1 | 1 of 1 |",
        "| mujoco -> reference, baseline |  |  | 1 of 2 |  | 1 of 2 |",
        "| reference -> reference, baseline | 1 of 2 |  |  |  |  |",
    ]
