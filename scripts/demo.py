"""From the sample drives to two fitted simulators and the table that compares them.

    python scripts/demo.py [OUTPUT]

Runs, with configs/demo.yaml, what one would run by hand: check the drives, look at them, train
models, fit MuJoCo, compare. Started again, it does not train again what is there.
"""

import subprocess
import sys
import time
from pathlib import Path

STEPS = (
    ("Are the drives fit for use?", "check_recordings.py", ["data/sample"]),
    ("What was driven?", "show_drives.py", ["configs/demo.yaml"]),
    ("Learn the car from its drives", "train_models.py", ["configs/demo.yaml"]),
    ("Fit MuJoCo to the same drives", "fit_mujoco.py", ["configs/demo.yaml"]),
    ("Which simulator to trust?", "evaluate_models.py", ["configs/demo.yaml"]),
)


def main() -> None:
    """Runs the steps one after the other."""
    if {"-h", "--help"} & set(sys.argv[1:]):
        print((__doc__ or "").strip())
        return
    output = sys.argv[1] if len(sys.argv) > 1 else "demo"
    scripts = Path(__file__).parent
    began = time.monotonic()
    for title, script, arguments in STEPS:
        own = [f"output={output}"] if arguments[-1].endswith(".yaml") else []
        print(f"\n== {title}\n   python scripts/{script} {' '.join(arguments + own)}\n", flush=True)
        command = [sys.executable, str(scripts / script), *arguments, *own]
        if subprocess.run(command).returncode:
            raise SystemExit(f"error: scripts/{script} did not finish; the lines above say why")
    print(f"\nDone in {time.monotonic() - began:.0f} s. Look at:")
    for name in ("table.png", "rollouts.png", "drives.png", "table.md", "mujoco_fitted.yaml"):
        print(f"  {output}/{name}")


if __name__ == "__main__":
    main()
