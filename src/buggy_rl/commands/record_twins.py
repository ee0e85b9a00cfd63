"""Makes drives of simulated cars in the place of recordings that cannot be shipped.

    python scripts/record_twins.py configs/twins/mocap_30hz.yaml
    python scripts/record_twins.py configs/twins/full_size.yaml drives=5 seconds=120 output=runs/t

Writes OUTPUT/before and OUTPUT/after (drives of the car as it was and since something has changed),
raw tables with names and units of their own, OUTPUT/car.yaml (the car's file) and OUTPUT/answer
(the right column map, the true parameters, what has changed). docs/recordings.md shows what is made
of them.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run, save_run


def main() -> None:
    """Drives and writes."""
    config = from_command_line(__doc__, "buggy_rl.proof.cases.twin:TwinConfig")

    import torch

    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.proof.cases.twin import ANSWER, recorded

    torch.set_num_threads(1)
    folder = Path(config.output)
    with tqdm(total=1.0, desc="driving", bar_format="{l_bar}{bar}| {elapsed}") as bar:
        for share in recorded(config):
            bar.update(share - bar.n)
    save_run(config, folder / ANSWER)  # it names what has changed
    print(f"2 x {config.drives} drives of {config.seconds:g} s of {config.car!r} in {folder}")


if __name__ == "__main__":
    run(main)
