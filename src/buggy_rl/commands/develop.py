"""Draws, records and searches development cases, and writes down all that a calibration may need.

    python scripts/develop.py configs/development.yaml
    python scripts/develop.py configs/development.yaml draw.first=210000 draw.cases=1000 workers=8
    python scripts/develop.py configs/development.yaml \
        "opened={runs/proof_third: runs/proof_third_sealed}"

One JSON line a case in OUTPUT/development.jsonl. Interrupted, it goes on with the cases that are
not in that file. Then counts how often the search comes to the true set, and says how well right
effects are told from physics that no effect describes, one sort left out at a time.
`scripts/calibrate.py` fits the probabilities of answers to these lines.
"""

from dataclasses import replace
from pathlib import Path

from buggy_rl.core.config import from_command_line, run, save_run
from buggy_rl.core.extras import needs

PART = 8  # cases of a job: a start costs it some 4 s, a case 20 to 200 s


def main() -> None:
    """Runs the cases that are missing."""
    config = from_command_line(__doc__, "buggy_rl.proof.calibrate.development:DevelopmentConfig")

    needs("sklearn", "proof", "telling right effects from unknown physics")
    from buggy_rl.jobs import results
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.proof.calibrate.development import Searching, parts_of
    from buggy_rl.proof.calibrate.discrimination import discrimination
    from buggy_rl.proof.cases.simulators import prepare, prepared_name, unprepared
    from buggy_rl.proof.score.tables import fitted_counts

    store, ledger = config.store, config.lines
    left = [] if config.opened else config.left
    store.prepared.mkdir(parents=True, exist_ok=True)
    scripts = Path(__file__).parent
    wanted = unprepared(left, store.prepared)
    jobs = [(case, store.prepared, scripts) for case in wanted]
    # Simulators of a plant share the drives that they are made from: one after the other.
    shared = [job for job in jobs if not job[0].spread]
    for case, folder, place in tqdm(shared, "preparing simulators", unit="simulator"):
        prepare(case, folder, place)
    own = [job for job in jobs if job[0].spread]
    with tqdm(desc="fitting simulators", total=len(own), unit="simulator") as bar:
        fits = {prepared_name(job[0]): job for job in own}
        for _ in results(prepare, fits, store.output / "jobs" / "prepare", config.workers, config):
            bar.update()
    # By seed: a run that is stopped has cases of every plant and pairing.
    parts = sorted(parts_of(left, PART), key=lambda part: part[0].seed)
    searching = Searching(store, "development", tuple(config.effects), config.stretches)
    runs = [(searching, parts)] if parts else []
    for place, cases in config.left_opened.items():
        own = replace(searching, store=place, driven=True)
        runs.append((own, [cases[i : i + PART] for i in range(0, len(cases), PART)]))
    total = sum(len(part) for _, parts in runs for part in parts)
    with tqdm(desc="searching", total=total, unit="case") as bar:
        for own, parts in runs:
            for count in own.into(ledger, parts, config.workers, config):
                bar.update(count)
    save_run(config, store.output)
    done = ledger.entries()
    failed = sum(bool(entry.failed) for entry in done)
    print(f"{ledger.file}: {len(done)} cases, {failed} of them failed")
    print(fitted_counts(done))
    print(discrimination(done))


if __name__ == "__main__":
    run(main)
