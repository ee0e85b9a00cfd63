"""Fits the posterior's weights to ledgers of development cases, and counts what they give.

    python scripts/calibrate.py \
        ledgers=docs/development/cases.jsonl.gz,docs/development/fresh.jsonl.gz
    python scripts/calibrate.py ledgers=runs/development/development.jsonl write=true
    python scripts/calibrate.py ledgers=docs/development/opened_03c9054.jsonl.gz apply=true \
        weights=docs/development/weights_1251.yaml

Prints what is named, case by case from weights that were fitted without its kind of unknown
physics, or its pairing; beside it, what the held-out loss alone would name. With `write=true` the
weights replace those that the package ships,
`src/buggy_rl/diagnosis/search/calibration.yaml`, with the
ledgers, their hashes and the number of cases they are from. With `apply=true` those weights, or
those of `weights=FILE`, are counted on other cases, and nothing is fitted. With `without=[FEATURE]`
features get no weight. Lines of earlier ledgers lack features: the weights that they give are the
mean of the prior of those of the later lines, which alone are counted, and its precision is theirs
by the share `counts`.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run
from buggy_rl.core.extras import needs


def main() -> None:
    """Fits, counts, and writes."""
    config = from_command_line(__doc__, "buggy_rl.proof.calibrate.calibration:CalibrateConfig")

    needs("sklearn", "proof", "telling right effects from unknown physics")
    from buggy_rl.core.files import write_atomically
    from buggy_rl.diagnosis.search.posterior import SHIPPED, load_calibration
    from buggy_rl.proof.calibrate.calibration import COUNTS, calibrated, content, left_out
    from buggy_rl.proof.calibrate.discrimination import discrimination
    from buggy_rl.proof.calibrate.intervals import (
        STEPS_TRIED,
        form_error,
        intervals,
        scored_numbers,
        step_intervals,
        steps,
    )
    from buggy_rl.proof.ledger import searched
    from buggy_rl.proof.score.tables import (
        best_single,
        by_pairing,
        counted,
        fitted_counts,
        lowest_loss,
        mcnemar,
    )

    if config.write and (config.without or config.counts != COUNTS):
        raise SystemExit("error: write=true is of all features: leave out without= and counts=")
    files = [Path(file) for file in config.ledgers]
    cases = searched(files)
    shipped = load_calibration(Path(config.weights or SHIPPED))
    if config.apply:
        found = [entry.posterior(shipped) for entry in cases]
        print(f"{len(cases)} cases, weights of {shipped.cases} other cases\n")
    else:
        calibration, ridge = calibrated(cases, config.without, config.counts)
        found, mean = left_out(cases, ridge, config.without, config.counts)
        print(f"{len(cases)} cases, ridge {ridge:g}, mean log probability of truths {mean:.3f}\n")
        if config.write:
            form, of = form_error(scored_numbers(cases)), steps(cases)
            step = form_error(of, STEPS_TRIED) if of else None
            made = content(calibration, form, files, len(cases), ridge, step)
            write_atomically(SHIPPED, made)
        if of_later := [i for i, e in enumerate(cases) if e.seen.null.changed is not None]:
            print(f"counted: the {len(of_later)} of them that have all features\n")
            cases, found = [cases[i] for i in of_later], [found[i] for i in of_later]
    methods = {
        name: [entry.scored(said) for entry, said in zip(cases, answers, strict=True)]
        for name, answers in {
            "posterior": found,
            "lowest loss": map(lowest_loss, cases),
            "best single": map(best_single, cases),
        }.items()
    }
    ours = methods["posterior"]
    print(counted(methods))
    print(f"\n{mcnemar(ours, methods['best single'], 'best single')}")
    print(f"\n{by_pairing(ours)}\n\n{fitted_counts(cases)}\n\n{discrimination(cases)}")
    print(f"\n{intervals(cases, shipped.form_error if config.apply else None)}")
    print(f"\n{step_intervals(cases, shipped.step_error if config.apply else None)}")


if __name__ == "__main__":
    run(main)
