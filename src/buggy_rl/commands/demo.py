"""Makes two fitted simulators of the sample drives, a policy trained in each, and a blind test.

    python scripts/demo.py [OUTPUT]

Runs what one would run by hand: check the drives, look at them, train models, fit MuJoCo, compare;
then train a policy in each simulator, by the same code and settings, and draw how they drive there
and on the reference car. At the end an effect drawn at random is concealed in a car: the diagnosis
names it, repairs the simulator, and the sealed answer is shown. Started again, it does not do again
what is there.
"""

import os
import re
import subprocess
import sys
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from buggy_rl.commands import as_typed
from buggy_rl.jobs.bar import PERIOD, tqdm

STEPS = (
    ("Are the drives fit for use?", "check_recordings.py", ["data/sample"]),
    ("What was driven?", "show_drives.py", ["configs/demo.yaml"]),
    ("Learn the car from its drives", "train_models.py", ["configs/demo.yaml"]),
    ("Fit MuJoCo to the same drives", "fit_mujoco.py", ["configs/demo.yaml"]),
    ("Which simulator to trust?", "evaluate_models.py", ["configs/demo.yaml"]),
)
SIMULATORS = {"learned": "models/history_mlp.pt", "mujoco": "mujoco_fitted.yaml"}
SETTINGS = ["configs/ppo.yaml", "configs/demo_policy.yaml"]  # of both: the engine alone differs
RESULTS = ("table.png", "rollouts.png", "drives.png", "policies.png", "mujoco_fitted.yaml")
BLIND_DEMO = ("blind_demo/blind_demo.png", "blind_demo/report.html")
BAR = "{desc:8}{percentage:3.0f}%|{bar:30}| {elapsed} < {remaining} {postfix}"
TAIL = 15  # last lines shown of what failed


def main() -> None:
    """Runs the steps one after the other, and both trainings at the same time."""
    if {"-h", "--help"} & set(sys.argv[1:]):
        print((__doc__ or "").strip())
        return
    output = sys.argv[1] if len(sys.argv) > 1 else "demo"
    began = time.monotonic()
    for title, script, arguments in STEPS:
        own = [f"output={output}"] if arguments[-1].endswith(".yaml") else []
        finish(title, script, arguments + own)
    train_policies(output)
    drawn = [f"policies.{name}={output}/policy_{name}/best.pt" for name in SIMULATORS]
    drawn += ["courses=[lap,infinity]", f"output={output}/policies.png"]
    finish("How do the policies drive?", "show_policies.py", drawn)
    finish("What was left out of a simulator?", "blind_demo.py", [f"output={output}/blind_demo"])
    print(f"\nDone in {time.monotonic() - began:.0f} s. Look at:")
    print("\n".join(f"  {output}/{name}" for name in RESULTS + BLIND_DEMO))


def announce(title: str, script: str, arguments: list[str]) -> list[str]:
    """Prints what comes next; the command."""
    command = as_typed(f"python scripts/{script} {' '.join(arguments)}")
    print(f"\n== {title}\n   {command}\n", flush=True)
    return [sys.executable, str(Path(__file__).parent / script), *arguments]


def finish(title: str, script: str, arguments: list[str]) -> None:
    """Runs one step to its end."""
    if subprocess.run(announce(title, script, arguments)).returncode:
        raise SystemExit(f"error: scripts/{script} did not finish; the lines above say why")


def train_policies(output: str) -> None:
    """Trains a policy in each simulator, at the same time; goes on where it was stopped."""
    commands = []
    for name, simulator in SIMULATORS.items():
        folder = f"{output}/policy_{name}"
        own = [f"engine.simulator={output}/{simulator}", f"output={folder}"]
        own += ["resume=true"] if Path(folder, "checkpoint.pt").is_file() else []
        commands.append(announce(f"Train a policy: {name}", "train_policy.py", SETTINGS + own))
    with ThreadPoolExecutor() as pool:
        said = list(pool.map(follow, SIMULATORS, commands, range(len(commands))))
    for name, (code, lines) in zip(SIMULATORS, said, strict=True):
        print("\n".join(lines if code else lines[-1:]))
        if code:
            raise SystemExit(f"error: the policy from {name} did not finish; see above")


def follow(name: str, command: list[str], position: int) -> tuple[int, list[str]]:
    """Runs a command behind a bar of its own; its exit code and its last lines."""
    lines: deque[str] = deque(maxlen=TAIL)
    often = {**os.environ, PERIOD: "1"}  # its lines are the bar here
    with (
        subprocess.Popen(
            command, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=often
        ) as process,
        tqdm(total=100, desc=name, position=position, bar_format=BAR) as bar,
    ):
        assert process.stdout is not None
        for line in process.stdout:
            if done := re.search(r"(\d+)%\|", line):
                told = re.search(r"[\d.]+ closed", line)
                bar.n = int(done[1])
                bar.set_postfix_str(told[0] if told else "")
            elif line.strip():
                lines.append(line.rstrip())
    return process.returncode, list(lines)


if __name__ == "__main__":
    main()
