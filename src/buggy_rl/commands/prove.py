"""Conceals physics in cars, diagnoses them, and scores the answers.

    python scripts/prove.py configs/proof.yaml
    python scripts/prove.py configs/proof_reference.yaml output=runs/proof_reference
    python scripts/prove.py configs/proof.yaml draw.split=sealed draw.first=2000 workers=2
    python scripts/prove.py configs/proof.yaml stages=score,page

Stages: prepare (simulators that are fitted first), seal (the hashes of all answers are published,
then the cases are driven), ask (scripts/diagnose.py, which is given one case and no answer), again
(where it cannot tell, the manoeuvre that it suggests is driven), weigh (the true structure fitted
to the same drives), compare (other methods), settle (complete cases are entered in the ledger, one
line each), score, page. A stage does nothing twice: stop it, start it. A case in the ledger is not
run again on any machine: with the same ledger, draw.cases=50 today and draw.cases=100 tomorrow are
100 cases.
"""

from pathlib import Path

from buggy_rl.commands import command_line
from buggy_rl.core.config import from_command_line, run, save_run


def main() -> None:
    """Runs the stages of the config."""
    config = from_command_line(__doc__, "buggy_rl.proof.proof:ProofConfig")

    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.proof.proof import cases_of, steps
    from buggy_rl.proof.score.outcome import OURS, Ledger, open_once, openings
    from buggy_rl.proof.score.score import score

    store, ledger = config.store, Ledger(config.ledger_file)
    for folder in (store.output, store.sealed, store.prepared):
        folder.mkdir(parents=True, exist_ok=True)
    drawn = cases_of(config)

    for step in steps(config, drawn, Path(__file__).parent):
        with tqdm(desc=step.title, total=step.total, unit="case") as bar:
            for count, message in step.results:
                bar.update(count)
                if message:
                    bar.write(message)
    save_run(config, store.sealed)  # beside the answers: it tells what they were drawn from
    if "settle" in config.stages:
        count = ledger.settle(store, compared="compare" in config.stages)
        print(f"{ledger.file}: {count} cases more, {len(ledger.entries())} in all")
    if not {"score", "page"} & set(config.stages):
        return
    scores = {method: score(found) for method, found in ledger.outcomes(store, drawn).items()}
    if "score" in config.stages:
        if config.draw.split == "sealed":
            open_once(config.counter)
        print("\n".join(scores[OURS].lines()))
    if "page" in config.stages:
        from buggy_rl.proof.page import write_page

        command = command_line(without="stages=")
        print(f"written: {write_page(config, scores, command, openings(config.counter))}")


if __name__ == "__main__":
    run(main)
