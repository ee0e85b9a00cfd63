"""Conceals physics in cars, asks the diagnosis about them, and counts what it answers.

    python scripts/prove.py configs/proof.yaml
    python scripts/prove.py configs/proof_reference.yaml output=runs/proof_reference
    python scripts/prove.py configs/proof_second.yaml workers=2
    python scripts/prove.py configs/proof.yaml stages=[score,page]

Stages: prepare (simulators that are fitted first), seal (the hashes of all answers are published,
then the cases are driven), ask (scripts/diagnose.py, which sees one case and no answer), again
(where it cannot tell, the manoeuvre that it asks for is driven), weigh (the true structure fitted
to the same drives), compare (other methods), settle (what is done with is entered in the ledger, a
line each), score, page. What is done is not done again: stop it, start it. Nor is what is settled,
on any machine: with the same ledger, draw.cases=50 today and draw.cases=100 tomorrow are a hundred.
"""

import sys
from pathlib import Path

from buggy_rl.config import from_command_line, run, save_run


def main() -> None:
    """Runs the stages that are asked for."""
    config = from_command_line(__doc__, "buggy_rl.blind_test.proof:ProofConfig")

    from tqdm import tqdm

    from buggy_rl.blind_test.again import again, drive_again, undecided
    from buggy_rl.blind_test.baselines import compare, uncompared
    from buggy_rl.blind_test.exam import Examiner
    from buggy_rl.blind_test.ledger import Ledger, outcomes
    from buggy_rl.blind_test.opening import open_once, openings
    from buggy_rl.blind_test.outcome import OURS
    from buggy_rl.blind_test.preparation import needed, prepare
    from buggy_rl.blind_test.proof import cases_of, side_by_side, unanswered, unsealed, unweighed
    from buggy_rl.blind_test.score import score
    from buggy_rl.blind_test.sealing import publish, seal

    vault, scripts = config.vault, Path(__file__).resolve().parent
    for folder in (vault.output, vault.sealed, vault.prepared):
        folder.mkdir(parents=True, exist_ok=True)
    save_run(config, vault.sealed)  # beside the answers: it tells what they were drawn from
    drawn = cases_of(config)
    ledger = Ledger(Path(config.ledger or vault.output / "ledger.jsonl"))
    cases = ledger.open(drawn)

    def together(what: str, work, arguments: list[tuple], weights: list[int]) -> None:
        with tqdm(total=sum(weights), desc=what, unit="case") as bar:
            for count in side_by_side(work, arguments, config.workers):
                bar.update(count)

    def ask(what: str, ids: list[str]) -> None:
        asked = unanswered(vault, ids)
        examiner = Examiner(scripts / "diagnose.py", config.limit, config.workers)
        for outcome in tqdm(
            examiner.run(asked), what, len(ids), initial=len(ids) - len(asked), unit="case"
        ):
            if outcome["status"] != "answered":
                tqdm.write(f"{outcome['status']}: {outcome['last_words'].strip()[-200:]}")

    if "prepare" in config.stages:
        for case in tqdm(needed(cases, vault.prepared), "preparing simulators"):
            prepare(case, vault.prepared, scripts)
    if "seal" in config.stages:
        publish(vault, drawn, config.secret)
        groups = unsealed(vault, cases)
        told = (config.effects, config.secret, config.stretches)
        arguments = [(vault, group, *told) for group in groups]
        together("sealing", seal, arguments, [len(group) for group in groups])
    if "ask" in config.stages:
        ask("asking", [case.id for case in cases])
    if "again" in config.stages:
        retried = undecided(vault, cases)
        together("driving again", drive_again, [(vault, c) for c in retried], [1] * len(retried))
        ask("asking again", [again(case) for case in cases if vault.seen(again(case)).exists()])
    if "weigh" in config.stages:
        from buggy_rl.blind_test.oracle import weigh

        left = unweighed(vault, cases)
        arguments = [(vault, case, config.effects, config.rivals) for case in left]
        together("weighing", weigh, arguments, [1] * len(left))
    if "compare" in config.stages:
        left = uncompared(vault, cases)
        together("comparing", compare, [(vault, case) for case in left], [1] * len(left))
    if "settle" in config.stages:
        count = ledger.settle(vault, compared="compare" in config.stages)
        print(f"{ledger.file}: {count} cases more, {len(ledger.entries())} in all")
    if "score" not in config.stages and "page" not in config.stages:
        return
    scores = {who: score(found) for who, found in outcomes(ledger, vault, drawn).items()}
    counter = Path(config.opened or vault.output / "opened.json")
    if "score" in config.stages:
        if config.draw.split == "sealed":
            open_once(counter)
        print("\n".join(scores[OURS].lines()))
    if "page" in config.stages:
        from buggy_rl.blind_test.page import write_page

        command = " ".join(["python", *(a for a in sys.argv if not a.startswith("stages="))])
        print(f"written: {write_page(config, scores, command, openings(counter))}")


if __name__ == "__main__":
    run(main)
