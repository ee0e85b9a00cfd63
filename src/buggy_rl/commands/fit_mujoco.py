"""Fits MuJoCo's friction, steering, delays, drive and resistance to drives.

    python scripts/fit_mujoco.py configs/sample.yaml
    python scripts/fit_mujoco.py configs/sample.yaml fit_simulator=single_track fit.iterations=5
    python scripts/fit_mujoco.py my_study.yaml fit_simulator=single_track car=f1tenth

Fits on the study's training drives, by least squares over windows of 1 s, and writes
OUTPUT/FITTED.yaml (mujoco_fitted.yaml), which every script takes as a simulator, and its config as
FITTED.config.yaml. Prints each parameter with its 95 % interval, and warns about what these drives
cannot determine, and about a fit that did not converge, ends at the edge of a range or is no better
than holding the velocity.
"""

import sys
from pathlib import Path

from buggy_rl.core.config import from_command_line, run, save_run


def main() -> None:
    """Fits and writes the simulator file."""
    config = from_command_line(
        __doc__, "buggy_rl.visual.study.stages:WholeStudyConfig"
    ).of_simulators

    import torch

    from buggy_rl.api.fitting import fitted_simulator
    from buggy_rl.estimation.fit_study import fit_file, fit_question, fit_setup, load_drives
    from buggy_rl.estimation.least_squares import second_pass
    from buggy_rl.jobs.bar import tqdm

    torch.set_num_threads(config.threads)
    drives = load_drives(config.data, tqdm.write, config.car)
    with tqdm(
        desc=f"fitting {config.fit_simulator}",
        total=config.fit.iterations + second_pass(config.fit),
    ) as bar:

        def show(metrics: dict[str, float]) -> None:
            bar.update()
            bar.set_postfix_str(f"cost {metrics['cost']:.0f}")

        setup = fit_setup(config)
        made = fitted_simulator(
            config.fit_simulator, drives.training, config.fit, **setup, show=show
        )

    print(f"{'parameter':24} {'fitted':>9} {'95 % interval':>21} {'from':>8}  unit")
    for e in made.fit.estimates:
        interval = f"{e.low:.4g} .. {e.high:.4g}"
        line = f"{e.parameter.name:24} {e.value:9.4g} {interval:>21} {e.parameter.value:8.4g}  "
        print(line + e.parameter.unit + "".join(f"\n    ! {warning}" for warning in e.warnings))
    asked = fit_question(config, drives)
    file = made.save(Path(config.output) / fit_file(config), asked)
    save_run(config, file.parent, file.stem)  # others in the folder have a config of their own
    print(f"written: {file}")
    for warning in made.warnings:
        print(f"WARNING: {warning}", file=sys.stderr)


if __name__ == "__main__":
    run(main)
