"""Conceals physics in cars, diagnoses them, and scores the answers.

    python scripts/prove.py configs/proof.yaml
    python scripts/prove.py configs/proof_reference.yaml output=runs/proof_reference
    python scripts/prove.py configs/proof.yaml draw.split=sealed draw.first=2000 workers=2
    python scripts/prove.py configs/proof.yaml stages=score,page

Stages: prepare (simulators that are fitted first), seal (the hashes of all answers are published,
then the cases are driven), ask (scripts/diagnose.py, which is given one case and no answer), again
(where it cannot tell, the manoeuvre that it suggests is driven), weigh (the true structure fitted
to the same drives), compare (other methods), settle (complete cases are entered in the ledger, one
line each: the answers and the hash of the truth), score and page (which open what is sealed: the
truth is added to the lines). A stage does nothing twice: stop it, start it. A case in the ledger is
not run again on any machine: with the same ledger, draw.cases=50 today and draw.cases=100 tomorrow
are 100 cases. A line that was not opened is opened where its case was sealed.
"""

from pathlib import Path

from buggy_rl.commands import command_line
from buggy_rl.core.config import from_command_line, run, save_run


def main() -> None:
    """Runs the stages of the config."""
    config = from_command_line(__doc__, "buggy_rl.proof.proof:ProofConfig")

    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.proof.cases.draw import drawn
    from buggy_rl.proof.ledger import OURS
    from buggy_rl.proof.proof import settle, steps
    from buggy_rl.proof.running import open_once, opened, openings
    from buggy_rl.proof.score.score import score

    store, ledger = config.store, config.lines
    for folder in (store.output, store.sealed, store.prepared):
        folder.mkdir(parents=True, exist_ok=True)
    cases = drawn(config.draw)

    for step in steps(config, cases, Path(__file__).parent):
        with tqdm(desc=step.title, total=step.total, unit="case") as bar:
            for count, message in step.results:
                bar.update(count)
                if message:
                    bar.write(message)
    save_run(config, store.sealed)  # beside the answers: it tells what they were drawn from
    if "settle" in config.stages:
        count = settle(config, cases)
        print(f"{ledger.file}: {count} cases more, {len(ledger.entries())} in all")
    if not {"score", "page"} & set(config.stages):
        return
    entries = opened(config, cases)
    methods = dict.fromkeys([OURS, *(method for entry in entries for method in entry.answers)])
    scores = {
        method: score([entry.scored(method) for entry in entries if method in entry.answers])
        for method in methods
    }
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
