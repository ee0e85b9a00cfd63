"""Gradient boosting in place of the conditional logit: does the posterior lose by being linear?

    python -m benchmarks.ranking "ledgers=[docs/development/cases.jsonl.gz]"

Both get the same features of the same cases (`diagnosis/search/posterior.py`) and answer each
case without its group (`calibration.case_folds`). Trees see the features of a hypothesis and
of its case together; a softmax over the case makes probabilities of their scores. Prints the tables
of both and McNemar's exact test.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from omegaconf import MISSING
from sklearn.ensemble import HistGradientBoostingClassifier

from buggy_rl.core.config import from_command_line, run
from buggy_rl.diagnosis.search.posterior import Posterior
from buggy_rl.proof.calibrate.calibration import (
    FOLDS,
    calibrated,
    case_folds,
    feature_table,
    left_out,
)
from buggy_rl.proof.ledger import Entry, searched
from buggy_rl.proof.score.tables import counted, mcnemar

TREES = {"learning_rate": 0.05, "max_iter": 100, "max_leaf_nodes": 8, "max_features": 0.5}
SEEDS = 3  # of trees, whose scores are averaged


@dataclass(frozen=True)
class RankingConfig:
    """Which cases."""

    ledgers: list[str] = MISSING
    """Files that scripts/develop.py wrote."""


def main() -> None:
    """Answers all cases by both and prints the tables."""
    config = from_command_line(__doc__, "benchmarks.ranking:RankingConfig")
    cases = searched(map(Path, config.ledgers))
    trees, (linear, _) = boosted(cases), left_out(cases, calibrated(cases)[1])
    logit, boosting = (
        [entry.scored(said) for entry, said in zip(cases, answers, strict=True)]
        for answers in (linear, trees)
    )
    print(counted({"conditional logit": logit, "gradient boosting": boosting}))
    print(f"\n{mcnemar(logit, boosting, 'gradient boosting')}")


def boosted(cases: Sequence[Entry]) -> list[Posterior]:
    """Posterior of each case by trees that were grown without its group."""
    of, part = feature_table(cases), case_folds(cases).numpy()
    alternatives = of.shut.numpy() == 0  # (n, H + 1)
    case, place = alternatives.nonzero()
    every = features(of.hypotheses.numpy(), of.case.numpy())[case, place]
    true = of.true.numpy()[case, place]
    scores = np.zeros(len(case))
    for number in range(FOLDS):
        out = part[case] == number
        for seed in range(SEEDS):
            grown = HistGradientBoostingClassifier(**TREES, random_state=seed)
            grown.fit(every[~out], true[~out])
            scores[out] += grown.decision_function(every[out]) / SEEDS
    found = []
    for row, entry in enumerate(cases):
        *named, unknown = torch.softmax(torch.tensor(scores[case == row]), 0).tolist()
        keys = [h.effects for h in entry.seen.fitted]
        found.append(Posterior(dict(zip(keys, named, strict=True)), unknown))
    return found


def features(hypotheses: NDArray[Any], case: NDArray[Any]) -> NDArray[Any]:
    """Of each alternative [n, H + 1, F + G]; that no effect describes it has none of the first."""
    none = np.full((len(case), 1, hypotheses.shape[-1]), np.nan)
    own = np.concatenate([hypotheses, none], 1)
    shared = np.broadcast_to(case[:, None], (*own.shape[:2], case.shape[-1]))
    return np.concatenate([own, shared], -1)


if __name__ == "__main__":
    run(main)
