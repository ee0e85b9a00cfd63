"""Diagnoses of plants whose friction was cut, by the unchanged plant as a black box.

    python -m benchmarks.grip_named
    python -m benchmarks.grip_named "plants=[mujoco]" "grips=[0.4]" "seeds=[710001,710002]"

Two drives of 30 s, the whole library. Prints how often `tire_grip` is the first name, at least
0.9 sure and within 10 % of the true friction. It resumes: cases in the output are kept.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Diagnoses what is left of the cases and prints the table."""
    config = from_command_line(__doc__, "benchmarks.gripping.named:NamedConfig")

    import torch
    from benchmarks.gripping.named import left, measured, table, written
    from tqdm import tqdm

    torch.set_num_threads(1)
    with tqdm(total=len(left(config)), unit="case") as bar:
        for row in measured(config):
            bar.set_postfix_str(f"{row['plant']} {row['grip']}: {row['first']}")
            bar.update()
    print(table(written(Path(config.output))))


if __name__ == "__main__":
    run(main)
