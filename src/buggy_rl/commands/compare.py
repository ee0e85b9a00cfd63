r"""Compares policy runs from their folders: curves with bands, a table, config differences.

    python scripts/compare.py runs.small=runs/small_0,runs/small_1 \
        runs.large=runs/large_0,runs/large_1 output=runs/comparison

Writes OUTPUT/curves.png, table.csv, table.md and differences.csv. A band ends where the shortest
run of its group ends; final and best values are those of each whole run.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Reads the runs, prints the tables and writes them with the curves."""
    config = from_command_line(__doc__, "buggy_rl.policies.evaluation.comparison:CompareConfig")

    from buggy_rl.figures.models import comparison_figure
    from buggy_rl.figures.style import save_figure
    from buggy_rl.policies.evaluation.comparison import compare_runs

    found, folder = compare_runs(config), Path(config.output)
    folder.mkdir(parents=True, exist_ok=True)
    found.table.to_csv(folder / "table.csv", index=False)
    found.differences.to_csv(folder / "differences.csv", index_label="option")
    lines = [[str(c) for c in found.table.columns], ["---"] * found.table.shape[1]]
    lines += [[_cell(v) for v in row] for row in found.table.itertuples(index=False)]
    text = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    (folder / "table.md").write_text(text)
    print(text)
    for name, metric, *_ in found.table.query("least_steps < most_steps").values:
        print(f"{name}, {metric}: runs differ in length; the band ends with the shortest")
    print(found.differences.to_string() if len(found.differences) else "no config value differs")
    save_figure(comparison_figure(found), folder / "curves.png")


def _cell(value) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    run(main)
