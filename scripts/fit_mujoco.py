"""Fits MuJoCo's friction, steering, delays, drive and resistance to drives.

    python scripts/fit_mujoco.py configs/sample.yaml
    python scripts/fit_mujoco.py configs/sample.yaml fit_simulator=single_track fit.iterations=5

Fits on the study's training drives, by least squares over windows of 1 s, and writes
OUTPUT/FITTED.yaml (mujoco_fitted.yaml), which every script takes as a simulator. Prints each
parameter with its 95 % interval, and warns about what these drives cannot determine.
"""

from pathlib import Path

from buggy_rl.config import from_command_line, run, save_run


def main() -> None:
    """Fits and writes the simulator file."""
    config = from_command_line(__doc__, "buggy_rl.identification.study:StudyConfig")

    import torch
    import yaml
    from tqdm import tqdm

    from buggy_rl import keys
    from buggy_rl.engines import make_engine
    from buggy_rl.estimation.segments import WARM_UP
    from buggy_rl.identification.least_squares import Simulator, as_simulator, fit, second_pass
    from buggy_rl.identification.study import fit_file, load_drives
    from buggy_rl.identification.table import block_numbers, thinned
    from buggy_rl.recordings.windows import filtered, local_parabola, windows

    torch.set_num_threads(config.threads)
    drives = load_drives(config.data, on_refusal=tqdm.write)
    length = WARM_UP + round(config.fit.horizon / drives.training[0].dt) + 1
    smooth = [filtered(r, config.fit.smoothing, local_parabola) for r in drives.training]
    cut, start = (
        thinned(windows(rows, length, length), config.fit.windows)
        for rows in (drives.training, smooth)
    )
    simulator = make_engine(config.fit_simulator, **config.fit_options)
    if not isinstance(simulator, Simulator):
        raise ValueError(f"{config.fit_simulator} declares no parameters to fit")
    with tqdm(
        desc=f"fitting {config.fit_simulator}",
        total=config.fit.iterations + second_pass(config.fit),
    ) as bar:

        def show(metrics: dict[str, float]) -> None:
            bar.update()
            bar.set_postfix_str(f"cost {metrics['cost']:.0f}")

        groups = block_numbers(cut)
        estimates = fit(simulator, cut, start[keys.VELOCITY], groups, config.fit, show)

    print(f"{'parameter':24} {'fitted':>9} {'95 % interval':>21} {'from':>8}  unit")
    for e in estimates:
        interval = f"{e.low:.4g} .. {e.high:.4g}"
        line = f"{e.parameter.name:24} {e.value:9.4g} {interval:>21} {e.parameter.value:8.4g}  "
        print(line + e.parameter.unit + "".join(f"\n    ! {warning}" for warning in e.warnings))
    file = Path(config.output) / fit_file(config)
    save_run(config, file.parent)
    content = as_simulator(config.fit_simulator, estimates, dict(config.fit_options))
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    print(f"written: {file}")


if __name__ == "__main__":
    run(main)
