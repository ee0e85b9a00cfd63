"""A car that differs from recording to recording: what is found, and what is taken for it.

    python benchmarks/by_recording.py
    python benchmarks/by_recording.py "simulators=[runs/fit/single_track.yaml]" seconds=60

Two drives of the reference car, with a fault at two sizes (`apart`) or at one of them in both
(`shared`), which no fitted set holds: the simulator as given is looked at alone. Prints what is
said to differ, and the share of what was left that it closes; rows are written to the output.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from buggy_rl.core.config import from_command_line, run

FAULTS = {  # fault -> parameter, and its two values
    "steering_gain": ("gain", 0.94, 1.06),
    "steering_offset": ("offset", -0.03, 0.03),
    "throttle_gain": ("gain", 0.92, 1.05),
    "tire_grip": ("grip", 0.7, 1.0),
    "rolling_resistance": ("deceleration", 0.0, 0.4),
    "viscous_drag": ("rate", 0.0, 0.3),
    "steering_dead_time": ("dead_time", 0.0, 0.04),
    "yaw_damping": ("rate", 0.0, 3.0),
    "payload": ("mass_ratio", 1.0, 1.25),
    "one_sided_drag": ("yaw_acceleration", -2.0, 2.0),
}


@dataclass(frozen=True)
class Config:
    """What is driven."""

    simulators: list[str] = field(default_factory=lambda: ["reference", "single_track"])
    """Simulators that the drives are compared with."""
    faults: list[str] = field(default_factory=lambda: list(FAULTS))
    """Faults of the list above."""
    seconds: float = 40.0
    """[s] of a drive."""
    seed: int = 500
    """Of the first drive."""
    output: str = "runs/by_recording.jsonl"
    """JSON lines."""


def main() -> None:
    """Looks at every pair of drives and prints a row of each."""
    config = from_command_line(__doc__, "by_recording:Config")

    import torch
    from tensordict import TensorDict
    from tqdm import tqdm

    from buggy_rl.core.vehicle import CONTROL_PERIOD
    from buggy_rl.diagnosis.config import DiagnosisConfig
    from buggy_rl.diagnosis.pipeline import open_case
    from buggy_rl.diagnosis.search.by_recording import by_recording
    from buggy_rl.diagnosis.search.result import State, tried_too
    from buggy_rl.policies.controllers.recording import RecordConfig, make_driver, recorded_steps
    from buggy_rl.recordings import Recording
    from buggy_rl.recordings.camera import Camera
    from buggy_rl.task.env import make_simulator

    torch.set_num_threads(1)

    def driven(name: str, values: tuple[float, ...], number: int) -> Recording:
        faults = {name: {FAULTS[name][0]: values[number]}}
        of = RecordConfig(output="", drives=1, seed=config.seed + number, faults=faults)
        engine = make_simulator(of.simulator, 1, **of.of_engine)
        rows = recorded_steps(engine, make_driver(of, engine), round(100 * config.seconds))
        data = Camera(of.camera, of.seed).recorded(
            cast(TensorDict, TensorDict.stack([*rows], 1))[0]
        )
        return Recording(f"drive_{number}", data, CONTROL_PERIOD)

    output = Path(config.output)
    output.parent.mkdir(parents=True, exist_ok=True)
    asked = [(n, kind) for n in config.faults for kind in ("apart", "shared")]
    rows = []
    with tqdm(total=len(asked) * len(config.simulators), unit="pair") as bar:
        for name, kind in asked:
            _, low, high = FAULTS[name]
            pair = (low, high) if kind == "apart" else (high, high)
            drives = [driven(name, pair, number) for number in (0, 1)]
            for simulator in config.simulators:
                question = DiagnosisConfig(
                    simulator=simulator,
                    recordings=["-"],
                    output="-",
                    parameters=False,
                    workers=1,
                )
                case = open_case(question, drives)
                problem = case.problem
                nothing = problem.library.hypothesis(())
                _, [null] = tried_too(State(problem, {}), [nothing], case.criteria)
                found = by_recording(case.criteria, problem, null, null, case.names)
                rows.append(
                    {
                        "fault": name,
                        "kind": kind,
                        "simulator": simulator,
                        "values": pair,
                        "left": null.held_out.sqrt().mean().item() - 1,
                        "differs": [d.to_dict() for d in found.differences],
                    }
                )
                bar.update()
    output.write_text("".join(json.dumps(row) + "\n" for row in rows))
    print(table(rows))


def table(rows: list[dict]) -> str:
    """A row of each pair."""
    lines = ["| fault | simulator | drives | is said to differ | closes |", "|---|---|---|---|--:|"]
    for row in rows:
        said = "; ".join(
            f"{d['effect']} "
            + " / ".join(f"{v:.3g}" for n in d["numbers"].values() for v in n.values())
            for d in row["differs"]
        )
        closes = f"{row['differs'][0]['closes']:.0%}" if row["differs"] else ""
        values = " / ".join(f"{v:g}" for v in row["values"])
        lines.append(
            f"| {row['fault']} | {row['simulator']} | {values} | {said or 'nothing'} | {closes} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    run(main)
