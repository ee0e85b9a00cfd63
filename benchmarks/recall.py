"""Every effect of the library concealed in the reference car at three strengths, and what is named.

    python -m benchmarks.recall
    python -m benchmarks.recall names=[understeer,voltage_sag] workers=1

Two drives of 30 s for each effect and strength; the simulator is the same car without the effect,
as a black box; the whole library and the shipped weights. Prints a row for each effect. One ledger
line a case in `output`, as of `scripts/develop.py`; it resumes: cases in the output are kept.
"""

import json
from pathlib import Path

from buggy_rl.config import from_command_line, run

PART = 4  # cases of a job


def main() -> None:
    """Searches what is left of the cases and prints the table."""
    config = from_command_line(__doc__, "benchmarks.recalling.cases:RecallConfig")

    from benchmarks.recalling.cases import left, table
    from tqdm import tqdm

    from buggy_rl.blind_test.development import developed, entries
    from buggy_rl.blind_test.sealing import CaseStore, groups
    from buggy_rl.jobs import results

    folder = Path(config.folder)
    store = CaseStore(folder, folder / "truth")
    cases = left(config)
    parts = [g[i : i + PART] for g in groups(cases) for i in range(0, len(g), PART)]
    calls = {part[0].id: (store, [], config.stretches, part) for part in parts}
    output = Path(config.output)
    output.parent.mkdir(parents=True, exist_ok=True)
    with tqdm(desc="searching", total=len(cases), unit="case") as bar:
        for lines in results(developed, calls, folder / "jobs", config.workers, config):
            with open(output, "a") as file:
                file.writelines(json.dumps(line) + "\n" for line in lines)
            bar.update(len(lines))
    print(table(entries(output)))


if __name__ == "__main__":
    run(main)
