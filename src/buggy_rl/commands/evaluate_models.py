"""Compares simulators on held-out drives: the original study's table 7.1.

    python scripts/evaluate_models.py configs/sample.yaml

Plays the commands of held-out windows into every model that scripts/train_models.py has trained,
MuJoCo as shipped and as scripts/fit_mujoco.py fitted it, the single-track car, a kinematic bicycle,
hold-last, and whatever `simulators` names. Writes OUTPUT/table.md, table.csv, table.png,
rollouts.png and rollouts.npz.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run, save_run


def main() -> None:
    """Judges every simulator of a study and writes the table."""
    config = from_command_line(
        __doc__, "buggy_rl.visual.study.stages:WholeStudyConfig"
    ).of_simulators

    import pandas as pd
    import torch

    from buggy_rl.api.fitting import judged_simulators
    from buggy_rl.estimation.fit_study import (
        compared_simulators,
        fit_file,
        load_drives,
        refuse_other_drives,
    )
    from buggy_rl.estimation.open_loop import measured_motion, save_rollouts
    from buggy_rl.estimation.table import held_out_segments, markdown
    from buggy_rl.figures.models import rollout_figure, table_figure
    from buggy_rl.jobs.bar import tqdm

    torch.set_num_threads(config.threads)
    folder = Path(config.output)
    drives = load_drives(config.data, tqdm.write, config.car)
    test = held_out_segments(drives.held_out, config.windows)
    rows, rollouts = [], {}
    found = list(compared_simulators(config, [r.name for r in drives.held_out]))
    refuse_other_drives(config, drives)
    unknown = sorted(set(config.shown) - {candidate.name for candidate in found})
    if unknown:
        raise ValueError(f"shown={unknown}: the simulators are {[c.name for c in found]}")
    if not (folder / fit_file(config)).is_file():
        print(f"no {fit_file(config)} in {folder}: scripts/fit_mujoco.py adds it to the table")
        found = [c for c in found if c.name != f"{config.fit_simulator}, fitted"]
    with tqdm(total=len(found), desc="judging", unit="simulator") as bar:
        for row, made in judged_simulators(found, test, bar.set_postfix_str):
            rows.append(row)
            rollouts[str(row["simulator"])] = made
            bar.update()
    table = markdown(rows, len(test.segments), len(drives.held_out))
    print(table)
    save_run(config, folder)
    (folder / "table.md").write_text(table)
    pd.DataFrame(rows).to_csv(folder / "table.csv", index=False)
    names = [drives.held_out[index].name for index in test.segments.recording.tolist()]
    file, dt = folder / "rollouts.npz", test.segments.dt
    save_rollouts(file, names, dt, measured_motion(test.segments), rollouts)
    best = [str(r["simulator"]) for r in sorted(rows, key=lambda r: r["position_mse_1s"])]
    shown = {name: rollouts[name] for name in config.shown or best[:3]}
    rollout_figure(measured_motion(test.segments), shown).savefig(folder / "rollouts.png", dpi=110)
    table_figure(rows).savefig(folder / "table.png", dpi=130)
    print(f"written: {folder}/table.md, table.csv, table.png, rollouts.png, rollouts.npz")


if __name__ == "__main__":
    run(main)
