"""Diagnoses development cases again with one rule of the selection switched off at a time.

    python scripts/prove.py configs/proof.yaml output=runs/development stages=[prepare,seal]
    python scripts/ablate.py proof=runs/development output=runs/ablation rules=[min_share]

A rule without which no answer is worse earns nothing. Writes OUTPUT/ablation.md. Interrupted, it
goes on where it stopped when it is started again.
"""

from pathlib import Path

from buggy_rl.config import from_command_line, run, save_run


def main() -> None:
    """Runs the diagnoses that are missing and writes the table."""
    config = from_command_line(__doc__, "buggy_rl.blind_test.ablation:AblationConfig")

    from tqdm import tqdm

    from buggy_rl.blind_test.ablation import ablations, table
    from buggy_rl.files import write_atomically
    from buggy_rl.jobs import run_jobs

    output = Path(config.output)
    save_run(config, output)
    jobs = ablations(config, Path(__file__).with_name("diagnose.py"))
    with tqdm(desc="diagnosing", total=len(jobs), unit="case") as bar:
        for progress in run_jobs(jobs, config.workers):
            bar.update(progress.outcome is not None)
            if progress.outcome is not None and progress.outcome.status != "done":
                bar.write(f"{progress.job.name}: {progress.outcome.last_words.strip()[-200:]}")
    text = table(config)
    write_atomically(output / "ablation.md", text)
    print(text)


if __name__ == "__main__":
    run(main)
