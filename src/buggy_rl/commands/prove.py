"""Conceals physics in cars, diagnoses them, and scores the answers.

    python scripts/prove.py configs/proof.yaml
    python scripts/prove.py configs/proof_reference.yaml output=runs/proof_reference
    python scripts/prove.py configs/proof.yaml draw.split=sealed draw.first=2000 workers=2
    python scripts/prove.py configs/proof.yaml stages=score,page

Stages: publish (the hashes of all answers and of the secret), prepare (simulators that are fitted
first), seal (the cases are driven; what was not published is), ask (scripts/diagnose.py, which is
given one case and no answer, and cannot read any other file of the run: Linux's Landlock, or
confine=false), again (where it cannot tell, the manoeuvre that it suggests is driven), weigh (the
true structure fitted to the same drives), compare (other methods), settle (complete cases are
entered in the ledger, one line each: the answers and the hash of the truth), score and page (which
open what is sealed: the truth is added to the lines; score publishes the secret). A stage does
nothing twice: stop it, start it. A case in the ledger is not run again on any machine: with the
same ledger and secret, draw.cases=50 today and draw.cases=100 tomorrow are 100 cases; of sealed
seeds, before the secret is published. A line that was not opened is opened where its case was
sealed; of a ledger in which all are, stages=[page] needs nothing else:

    python scripts/prove.py configs/proof_third.yaml output=docs/proof/third "stages=[page]"

Counted are the cases that were answered by the code of the last one: what was opened before is a
development case of that code.
"""

from pathlib import Path

from buggy_rl.commands import command_line
from buggy_rl.core.config import from_command_line, run, save_run


def main() -> None:
    """Runs the stages of the config."""
    config = from_command_line(__doc__, "buggy_rl.proof.proof:ProofConfig")

    from buggy_rl.proof.ledger import of_last_code
    from buggy_rl.proof.running import all_opened, openings

    alone = {*config.stages} == {"page"}
    entries = all_opened(config) if alone else []
    every = entries or run_stages(config)
    entries = of_last_code(every)
    if not {"score", "page"} & set(config.stages):
        return
    from buggy_rl.proof.ledger import OURS, SEALED, answered_by
    from buggy_rl.proof.score.answers import answer_rows
    from buggy_rl.proof.score.figures import lines_of
    from buggy_rl.proof.score.rivals import comparisons, scores_of
    from buggy_rl.proof.score.weighing import answer_of

    scores, compared = scores_of(entries), comparisons(entries)
    answers = [answer_of(entry.scored(), entry.weighed) for entry in entries]
    if "score" in config.stages:
        lines = [*lines_of(answer_rows(answers)), *scores[OURS].lines(), *map(str, compared)]
        publish_score(config, lines, count=config.draw.split in SEALED)
    if "page" in config.stages:
        from buggy_rl.proof.markdown import fill
        from buggy_rl.proof.page import page_tables, write_page

        command = command_line() if alone else command_line(without="stages=")
        times = openings(config.counter)
        made = answered_by(entries, every)
        print(f"written: {write_page(config, scores, compared, command, times, answers, made)}")
        tables = page_tables(answers, compared, made)
        for page in map(Path, config.pages):
            fill(page, {f"{config.draw.split}_{name}": text for name, text in tables.items()})
            print(f"written: {page}")


def run_stages(config):
    """Runs the stages before `score`; the entries, opened, where they are to be counted."""
    from buggy_rl.proof.cases.draw import drawn
    from buggy_rl.proof.cases.secret import secret_of
    from buggy_rl.proof.proof import settle, steps

    make_folders(config)
    secret = secret_of(config.store)
    cases = drawn(config.draw, secret)
    return entered(config, cases, steps(config, cases, secret, Path(__file__).parent), settle)


def entered(config, cases, steps, settle):
    """Runs steps and enters complete cases; the entries, opened, where they are to be counted."""
    from buggy_rl.proof.running import opened

    run_steps(steps)
    save_run(config, config.store.sealed)  # beside the answers: it tells what they were drawn from
    if "settle" in config.stages:
        tell_settled(config, settle(config, cases))
    return opened(config, cases) if {"score", "page"} & {*config.stages} else []


def make_folders(config) -> None:
    """Makes the folders of a run of sealed cases."""
    store = config.store
    for folder in (store.output, store.sealed, store.prepared):
        folder.mkdir(parents=True, exist_ok=True)


def run_steps(steps) -> None:
    """Runs the steps of such a run, each behind a bar."""
    from buggy_rl.jobs.bar import tqdm

    for step in steps:
        with tqdm(desc=step.title, total=step.total, unit="case") as bar:
            for count, message in step.results:
                bar.update(count)
                if message:
                    bar.write(message)


def tell_settled(config, count: int) -> None:
    """Prints how many cases were entered in the ledger."""
    ledger = config.lines
    print(f"{ledger.file}: {count} cases more, {len(ledger.entries())} in all")


def publish_score(config, lines, count: bool = True) -> None:
    """Prints the score and publishes the secret, after which every hash can be checked."""
    from buggy_rl.proof.cases.secret import publish_secret
    from buggy_rl.proof.running import open_once

    if count:
        open_once(config.counter)
    print("\n".join(lines))
    print(f"published: {publish_secret(config.store)}")


if __name__ == "__main__":
    run(main)
