"""Step tests of all simulators of a study, within what its training recordings show.

    python benchmarks/step_tests.py configs/dart.yaml

Prints what each simulator of the study's table does in the step tests of a diagnosis
(src/buggy_rl/diagnosis/answer/step_tests.py): so a published model, a fit and a repair are compared
whatever their parameters are called. Writes OUTPUT/step_tests.csv.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Tests every simulator that steps by commands."""
    config = from_command_line(
        __doc__, "buggy_rl.visual.study.stages:WholeStudyConfig"
    ).of_simulators

    import pandas as pd
    from tqdm import tqdm

    from buggy_rl.core.longitudinal import declared_by
    from buggy_rl.diagnosis.answer.step_tests import Driven, step_tests
    from buggy_rl.estimation.fit_study import compared_simulators, load_drives
    from buggy_rl.estimation.hypothesis import Library
    from buggy_rl.estimation.rollout import Simulation
    from buggy_rl.estimation.segments import cut_segments

    drives = load_drives(config.data, tqdm.write, config.car)
    segments = cut_segments(drives.training, 1.0, 1.0)
    library, rows = Library([]), {}
    neutral = library.hypothesis(())
    for candidate in compared_simulators(config, [r.name for r in drives.held_out]):
        if candidate.name == "hold last":
            continue
        driven = Driven.of(segments, declared_by(candidate.make(1)).rest)
        simulation, given = Simulation(candidate.make), [(neutral, neutral.vector)]
        [row] = step_tests(simulation, library, given, driven, segments.dt).tolist()
        named = zip(driven.quantities, row, strict=True)
        rows[candidate.name] = {f"{q.words} [{q.unit}]": value for q, value in named}
    table = pd.DataFrame(rows)
    table.to_csv(Path(config.output) / "step_tests.csv")
    print(table.to_markdown(floatfmt=".3g"))


if __name__ == "__main__":
    run(main)
