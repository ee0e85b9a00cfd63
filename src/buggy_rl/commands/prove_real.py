"""Conceals effects in recordings of real cars, diagnoses them, and scores the answers.

    python scripts/prove_real.py configs/proof_real.yaml
    python scripts/prove_real.py configs/proof_real.yaml workers=8 draw.cases=400
    python scripts/prove_real.py configs/proof_real.yaml stages=known,page

A real car driven by u gave y. For an effect on the commands there is a log u' such that the car
with the effect, driven by u', gives exactly y; for an effect of the sensor y' follows from y. One
half of a car's recordings is edited so, the other is the baseline.

Stages: prepare (a simulator is fitted to each untouched half), seal (the hashes of all answers and
of the secret are published, then recordings are edited), ask (scripts/diagnose.py, which is given
one case and no answer, and cannot read any other file of the run: Linux's Landlock, or
confine=false), weigh (how strongly what is concealed shows), settle (complete cases are
entered in the ledger, with the hash of the truth), score (opens what is sealed and publishes the
secret), known (real changes that are known, measured without a simulator and diagnosed), page. A
stage does nothing twice: stop it, start it.
"""

from pathlib import Path

from buggy_rl.commands import command_line
from buggy_rl.commands.prove import entered, make_folders, publish_score, run_steps
from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Runs the stages of the config."""
    config = from_command_line(__doc__, "buggy_rl.proof.real.real:RealProofConfig")

    from buggy_rl.proof.ledger import of_last_code
    from buggy_rl.proof.running import all_opened, openings

    alone = not {*config.stages} - {"known", "page"}
    entries = all_opened(config) if alone else []
    every = entries or run_stages(config)
    entries = of_last_code(every)
    if "known" in config.stages and config.known.data is not None:
        from buggy_rl.proof.real.real import known_steps

        run_steps(known_steps(config, Path(__file__).parent))
    if {"score", "page"} & {*config.stages}:
        from buggy_rl.proof.ledger import answered_by
        from buggy_rl.proof.markdown import fill
        from buggy_rl.proof.real.known import known_results
        from buggy_rl.proof.real.page import real_tables, write_real_page
        from buggy_rl.proof.real.score import RealOutcome, real_score

        score = real_score([RealOutcome.of(entry) for entry in entries])
        if "score" in config.stages:
            publish_score(config, score.lines())
        if "page" in config.stages:
            known = known_results(config.store, config.known.changes)
            command = command_line() if alone else command_line(without="stages=")
            times = openings(config.counter)
            made = answered_by(entries, every)
            page = write_real_page(config, score, known, command, times, made)
            print(f"written: {page}")
            tables = real_tables(score, made)
            for other in map(Path, config.pages):
                fill(other, {f"{config.kind}_{name}": text for name, text in tables.items()})
                print(f"written: {other}")


def run_stages(config):
    """Runs the stages before `score`; the entries, opened, where they are to be counted."""
    from buggy_rl.proof.cases.secret import secret_of
    from buggy_rl.proof.real.dataset import load_datasets
    from buggy_rl.proof.real.draw import drawn
    from buggy_rl.proof.real.real import settle, steps

    make_folders(config)
    if not {*config.stages} - {"known"}:
        return []
    secret = secret_of(config.store)
    datasets = load_datasets(config.datasets)
    cases = drawn(config.draw, datasets, secret)
    planned = steps(config, datasets, cases, secret, Path(__file__).parent)
    return entered(config, cases, planned, settle)


if __name__ == "__main__":
    run(main)
