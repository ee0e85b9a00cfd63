"""Training on in a repaired simulator beside training anew there: waypoints and seconds.

    python -m benchmarks.continued simulator=runs/sample/models/ensemble_of_history_mlps.pt
    python -m benchmarks.continued "algorithms=[ppo]" "seeds=[0]"

A policy is trained in the simulator as it is, and looked at in the simulator with each change
(`before`). There one is trained anew, and the one from before is trained on for a tenth of the
steps. All are judged on twenty paths that no training sees, none chosen by them. A row a policy in
`output`; run again, rows that are in it are not repeated.
"""

import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
import yaml
from benchmarks.first_order import append, new_training, read

from buggy_rl.core.config import build, from_command_line, run
from buggy_rl.jobs.bar import tqdm
from buggy_rl.policies.closed_loop import drive
from buggy_rl.policies.training.actor_critic import Policy, load_policy, save_policy
from buggy_rl.policies.training.run import PolicyRunConfig, validation_environment

COLUMNS = ("algorithm", "change", "seed", "arm", "steps", "cpu_seconds", "waypoints", "kept_on")
# Such that the policy from before drives worse: with an offset of the steering it did not.
CHANGES = {
    "late, weak steering": {
        "steering_gain": {"gain": 0.7},
        "steering_lag": {"time_constant": 0.08},
    },
    "slow servo": {"steering_lag": {"time_constant": 0.15}},
    "late commands": {
        "steering_dead_time": {"dead_time": 0.08},
        "throttle_dead_time": {"dead_time": 0.08},
    },
}
CONTINUED = {
    "shac": ["configs/shac_continued.yaml"],
    "ppo": ["ppo.steps=300_000"],
}


@dataclass(frozen=True)
class ContinuedConfig:
    """What is trained."""

    simulator: str = "runs/sample/models/ensemble_of_history_mlps.pt"
    """Before it is changed."""
    algorithms: list[str] = field(default_factory=lambda: ["shac"])
    """Each with the config of its name."""
    seeds: list[int] = field(default_factory=lambda: [0, 1, 2])
    folder: str = "runs/continued"
    """Of policies and changed simulators."""
    output: str = "runs/continued/continued.csv"
    """Rows, appended."""


def main() -> None:
    """Trains what is left, and prints what was gained."""
    config = from_command_line(__doc__, "benchmarks.continued:ContinuedConfig")
    torch.set_num_threads(1)
    Path(config.folder).mkdir(parents=True, exist_ok=True)
    asked = [
        (algorithm, seed, change)
        for algorithm in config.algorithms
        for seed in config.seeds
        for change in CHANGES
    ]
    for algorithm, seed, change in tqdm(asked, "training", unit="change"):
        _change(config, algorithm, seed, change)
    print(summary(read(Path(config.output))))


def _change(config: ContinuedConfig, algorithm: str, seed: int, change: str) -> None:
    """Adds the rows of one change."""
    begun = Path(config.folder) / f"{algorithm}_{seed}.pt"
    if not begun.exists():
        policy, _, _ = _trained(algorithm, seed, config.simulator)
        save_policy(policy, begun, {})
    changed = Path(config.folder) / f"{change.replace(', ', '_').replace(' ', '_')}.yaml"
    engine = str(Path(config.simulator).resolve())
    changed.write_text(yaml.safe_dump({"engine": engine, "effects": CHANGES[change]}))
    file = Path(config.output)
    known = {(row["algorithm"], row["change"], int(row["seed"]), row["arm"]) for row in read(file)}
    more = {
        "anew": [],
        "continued": [*CONTINUED[algorithm], f"start={begun}"],
    }
    for arm in ("before", *more):
        row = {"algorithm": algorithm, "change": change, "seed": seed, "arm": arm}
        if tuple(row.values()) in known:
            continue
        policy, steps, seconds = load_policy(begun)[0], 0, 0.0
        if arm in more:
            policy, steps, seconds = _trained(algorithm, seed, str(changed), more[arm])
        row |= {"steps": steps, "cpu_seconds": round(seconds, 1)}
        append(file, [row | _judged(str(changed), policy)], COLUMNS)


def _trained(
    algorithm: str, seed: int, simulator: str, more: Sequence[str] = ()
) -> tuple[Policy, int, float]:
    """A policy, the steps and the CPU seconds that it took; clocks run for the training alone."""
    _, policy, trainer = new_training(algorithm, seed, simulator, more)
    begun = time.process_time()
    for _ in trainer.run():
        pass
    return policy, trainer.steps, time.process_time() - begun


def _judged(simulator: str, policy: Policy) -> dict[str, Any]:
    """Means over the selection and the validation paths: none was used to choose the policy."""
    layers = ["configs/shac.yaml", "output=unused", f"engine.simulator={simulator}"]
    asked = build(PolicyRunConfig, layers)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        scores = drive(validation_environment(asked), policy.driver(), asked.validation_steps)
    found = scores.means()
    return {name: round(found[name], 3) for name in ("waypoints", "kept_on")}


def summary(rows: list[dict[str, str]]) -> str:
    """Medians over seeds, and the share of the gain of a training anew that training on has."""
    text = [
        "| algorithm, change | before | anew | trained on | share of the gain | of the seconds |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for algorithm, change in dict.fromkeys((row["algorithm"], row["change"]) for row in rows):
        own = [r for r in rows if (r["algorithm"], r["change"]) == (algorithm, change)]
        middle = {
            (arm, column): statistics.median(float(r[column]) for r in own if r["arm"] == arm)
            for arm in ("before", "anew", "continued")
            for column in ("waypoints", "cpu_seconds")
        }
        before, anew, on = (middle[a, "waypoints"] for a in ("before", "anew", "continued"))
        share = (on - before) / (anew - before)
        time_share = middle["continued", "cpu_seconds"] / middle["anew", "cpu_seconds"]
        text.append(
            f"| {algorithm}, {change} | {before:.1f} | {anew:.1f} | {on:.1f} "
            f"| {share:.0%} | {time_share:.0%} |"
        )
    return "\n".join(text)


if __name__ == "__main__":
    run(main)
