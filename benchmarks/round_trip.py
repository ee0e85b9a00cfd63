"""Effects concealed in reference cars of three sizes, at three rates, and how many are named.

    python -m benchmarks.round_trip
    python -m benchmarks.round_trip "scales=[10]" "rates=[20]" seeds=12

One effect is concealed in a car with brakes and reverse, and two drives are diagnosed with the same
car without the effect as simulator. A case has the same effect, size and driver in every car and at
every rate, scaled by the laws of similarity. The buggy with its one-way throttle at 100 Hz has it
too, unless it is one of brakes. It resumes: cases in the output are kept.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Diagnoses what is left of the cases and prints the table."""
    config = from_command_line(__doc__, "benchmarks.round_tripping.cases:RoundTripConfig")

    import torch
    from benchmarks.round_tripping.cases import left, measured, written
    from benchmarks.round_tripping.table import table
    from tqdm import tqdm

    torch.set_num_threads(1)
    with tqdm(total=len(left(config)), unit="case") as bar:
        for row in measured(config):
            bar.set_postfix_str(f"{row['truth']}: {row['first']}")
            bar.update()
    print(table(written(Path(config.output))))


if __name__ == "__main__":
    run(main)
