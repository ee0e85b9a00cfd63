"""Every effect of the library concealed in the reference car at three strengths, and what is named.

    python -m benchmarks.recall
    python -m benchmarks.recall names=[understeer,voltage_sag] workers=1
    python -m benchmarks.recall cases=false pages=[README.md] \
        output=docs/development/recall.jsonl.gz

Two drives of 30 s for each effect and strength; the simulator is the same car without the effect,
as a black box; the whole library and the shipped weights. Prints a row for each effect. One ledger
line a case in `output`, as of `scripts/develop.py`; it resumes: cases in the output are kept.
With `cases=false` the output is only read; `pages` get their column "named first" from it.
"""

import json
from pathlib import Path
from typing import Any

from buggy_rl.core.config import from_command_line, run

PART = 4  # cases of a job


def main() -> None:
    """Searches what is left of the cases, prints the table and fills in pages."""
    config = from_command_line(__doc__, "benchmarks.recalling.cases:RecallConfig")

    from benchmarks.recalling.cases import table
    from benchmarks.recalling.page import write_column

    from buggy_rl.proof.calibrate.development import entries

    output = Path(config.output)
    if config.cases:
        _search(config, output)
    print(table(entries(output)))
    for page in config.pages:
        write_column(Path(page), entries(output))


def _search(config: Any, output: Path) -> None:
    from benchmarks.recalling.cases import left
    from tqdm import tqdm

    from buggy_rl.jobs import results
    from buggy_rl.proof.calibrate.development import developed
    from buggy_rl.proof.cases.sealing import CaseStore, groups

    folder = Path(config.folder)
    store = CaseStore(folder, folder / "truth")
    cases = left(config)
    parts = [g[i : i + PART] for g in groups(cases) for i in range(0, len(g), PART)]
    calls = {part[0].id: (store, [], config.stretches, part) for part in parts}
    output.parent.mkdir(parents=True, exist_ok=True)
    with tqdm(desc="searching", total=len(cases), unit="case") as bar:
        for lines in results(developed, calls, folder / "jobs", config.workers, config):
            with open(output, "a") as file:
                file.writelines(json.dumps(line) + "\n" for line in lines)
            bar.update(len(lines))


if __name__ == "__main__":
    run(main)
