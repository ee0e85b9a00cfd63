"""Suggested manoeuvres: how often they are predicted to decide, and how often they do.

    python -m benchmarks.manoeuvres
    python -m benchmarks.manoeuvres "seeds=[720001,720002]" "effects=[viscous_drag]"

A reference car in which one effect is concealed is driven poorly, so that another effect explains
the recordings as well. Where the diagnosis is not sure, the manoeuvre with the highest decision
rate is driven in that car, and all drives are diagnosed again. It resumes: cases in the output are
kept.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Diagnoses what is left of the cases and prints the table."""
    config = from_command_line(__doc__, "benchmarks.deciding.cases:DecidingConfig")

    import torch
    from benchmarks.deciding.cases import left, measured, table, written
    from tqdm import tqdm

    torch.set_num_threads(1)
    with tqdm(total=len(left(config)), unit="case") as bar:
        for row in measured(config):
            bar.set_postfix_str(f"{row['truth']}: {row['manoeuvre'] or row['before']}")
            bar.update()
    print(table(written(Path(config.output))))


if __name__ == "__main__":
    run(main)
