"""Faults injected into drives of the simulated car, in real time, at random moments.

    python benchmarks/car_faults.py
    python benchmarks/car_faults.py "faults=[frozen,loop_killed]" times=10 output=runs/faults.csv
    python benchmarks/car_faults.py jobs=2
    python benchmarks/car_faults.py times=0 "pages=[docs/car.md,benchmarks/README.md]"

Prints, for each fault, how long the wheels took to get no drive, and no drive with the wheels
straight, by the simulated car's own log, and what the recordings miss. It resumes: lines in the
output are kept. `times=0` makes none and writes the table into the pages.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Makes what is left of the campaign and prints the table."""
    config = from_command_line(__doc__, "faults.campaign:CampaignConfig")

    from tqdm import tqdm

    from buggy_rl.proof.markdown import fill
    from faults.campaign import injections, left
    from faults.table import PLACE, summary

    total = sum(left(config).values())
    with tqdm(total=total, desc="faults", unit="fault") as bar:
        for injection in injections(config):
            bar.set_postfix_str(injection.fault)
            bar.update()
    table = summary(Path(config.output))
    for page in config.pages:
        fill(Path(page), {PLACE: table})
    print(table)


if __name__ == "__main__":
    run(main)
