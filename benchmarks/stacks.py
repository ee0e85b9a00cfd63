"""Stacks of layers on development cases: how much of a mismatch they close, and what they are.

    python -m benchmarks.stacks
    python -m benchmarks.stacks draw.first=420000 draw.cases=40 workers=2 output=runs/stacks.jsonl
    python -m benchmarks.stacks cases=false weigh=true output=runs/stacks.jsonl

Each case is driven, diagnosed as a user would, and rolled out on a drive that nothing was fitted
to: as given, by what is delivered, with the simulator's own parameters alone, and with a learned
residual alone. One JSON line a case; run again, cases that are in `output` are not repeated.
With `weigh=true` the truth of each is fitted too (OUTPUT.weighed.jsonl): what could be found.
"""

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any

import torch

from buggy_rl.core.config import from_command_line, run
from buggy_rl.diagnosis.pipeline import Diagnosed, run_diagnosis
from buggy_rl.diagnosis.repair.proof import repair_candidates
from buggy_rl.diagnosis.run.case import segments_of
from buggy_rl.estimation.hypothesis import Hypothesis
from buggy_rl.jobs.bar import tqdm
from buggy_rl.proof.baselines.asked import open_question
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.draw import DrawConfig, drawn
from buggy_rl.proof.cases.sealing import CaseStore, seal, unsealed
from buggy_rl.proof.cases.simulators import prepare, unprepared
from buggy_rl.proof.score.answers import WeighedAnswer, answer_rows
from buggy_rl.proof.score.figures import written
from buggy_rl.proof.score.held_out import stack_errors
from buggy_rl.proof.score.outcome import CaseAnswer, ScoredCase
from buggy_rl.proof.score.stack import SIMPLER
from buggy_rl.proof.score.weighing import answer_of, shown
from buggy_rl.recordings import load_recordings


def _pairings() -> DrawConfig:
    return DrawConfig(
        first=420_000,
        cases=40,
        library="present",
        families=["nothing", "one", "one", "two", "composed", "composed"],
        pairings=[
            *("reference", "reference_baseline", "reference_single_track"),
            *("reference_single_track_alone", "mujoco_single_track", "mujoco_single_track_alone"),
        ],
        driving=["rich", "rich", "rich", "steady", "timid", "wild"],
        seconds=[30.0],
    )


@dataclass(frozen=True)
class StacksConfig:
    """Which cases to diagnose."""

    draw: DrawConfig = field(default_factory=_pairings)
    stretches: int = 48
    """Segments of 1 s that are diagnosed."""
    minutes: float = 10.0
    """Time for a diagnosis."""
    workers: int = 2
    """Cases at a time."""
    folder: str = "runs/stacks"
    """Folder of cases while they are worked on."""
    output: str = "runs/stacks/stacks.jsonl"
    """JSON lines, appended."""
    cases: bool = True
    """Whether the cases that are left are run; else the lines are only read."""
    weigh: bool = False
    """Whether cases are weighed that were run: how strongly what is concealed shows."""
    rivals: int = 6
    """Other effects that are fitted to weigh a case."""


def main() -> None:
    """Runs what is left, and prints what it came to."""
    config = from_command_line(__doc__, "benchmarks.stacks:StacksConfig")
    output = Path(config.output)
    if config.cases:
        _run(config, output)
    if config.weigh:
        _weigh(config, output)
    weighed = {line["seed"]: line for line in read(_beside(output))}
    print(summary([_answer(line, weighed) for line in read(output) if "failed" not in line]))


def _beside(output: Path) -> Path:
    """File of what was weighed."""
    return output.with_suffix(".weighed.jsonl")


def _run(config: StacksConfig, output: Path) -> None:
    known = {line["case"]["seed"] for line in read(output)}
    left = [case for case in drawn(config.draw) if case.seed not in known]
    folder = Path(config.folder)
    store = CaseStore(folder, folder / "truth")
    for path in (store.prepared, store.sealed, output.parent):
        path.mkdir(parents=True, exist_ok=True)
    scripts = Path(__file__).parents[1] / "scripts"
    for case in tqdm(unprepared(left, store.prepared), "preparing simulators", unit="simulator"):
        prepare(case, store.prepared, scripts)
    with (
        tqdm(desc="cases", total=len(left), unit="case") as bar,
        ProcessPoolExecutor(config.workers, get_context("spawn")) as pool,
    ):
        jobs = [pool.submit(_part, config, part) for part in _parts(store, left)]
        for job in as_completed(jobs):
            bar.update(job.result())


def _parts(store: CaseStore, left: Sequence[Case]) -> list[Sequence[Case]]:
    """Cases of one job each, in the order of their seeds: what is done first is a draw as well."""
    apart = [[case] for case in left if store.truth(case.id).exists()]
    together = [part[i : i + 8] for part in unsealed(store, left) for i in range(0, len(part), 8)]
    return sorted([*apart, *together], key=lambda part: min(case.seed for case in part))


def _part(config: StacksConfig, part: Sequence[Case]) -> int:
    """Drives cases of one batch unless they are, and diagnoses them; how many."""
    torch.set_num_threads(1)
    folder = Path(config.folder)
    store = CaseStore(folder, folder / "truth")
    if unsealed(store, part):
        seal(store, part, [], segments=config.stretches)
    for case in part:
        line = json.dumps(_line(store, case, config.minutes)) + "\n"
        with Path(config.output).open("a", buffering=len(line) + 1) as lines:
            lines.write(line)  # at once: other workers append to the same file
    return len(part)


def read(output: Path) -> list[dict[str, Any]]:
    """Lines so far."""
    if not output.exists():
        return []
    return [json.loads(line) for line in output.read_text().splitlines()]


def _line(store: CaseStore, case: Case, minutes: float) -> dict[str, Any]:
    begun = time.monotonic()
    line: dict[str, Any] = {"case": asdict(case), "truth": case.truth, "family": case.family}
    try:
        line |= _diagnosed(store, case, minutes)
    except (ValueError, RuntimeError) as error:  # a car that only spins, a drive in pieces
        line["failed"] = f"{type(error).__name__}: {error}"
    return line | {"seconds": round(time.monotonic() - begun, 1)}


def _diagnosed(store: CaseStore, case: Case, minutes: float) -> dict[str, Any]:
    asked = open_question(store.inputs(case.id))
    config = replace(asked.config, minutes=minutes, workers=1)
    begun = time.monotonic()
    done = run_diagnosis(config, asked.recordings, baseline=asked.baseline)
    took = time.monotonic() - begun
    drives, refusals = load_recordings(
        [str(store.held_out(case.id))], config.columns or None, config.dt, car=config.car
    )
    if refusals:
        raise ValueError("; ".join(map(str, refusals)))
    aside, said = segments_of(drives, config), done.answer.to_dict()
    stack = done.answer.repair.simulation(done.case)
    errors = stack_errors(done.case, stack, aside, {"named": _named(done)})
    return {
        "verdict": said["verdict"],
        "effects": said["effects"],
        "layers": said["layers"],
        "more": said["more_is_missing"],
        "by_recording": said["by_recording"],
        "evidence": done.found.observed.rounded.to_dict() if done.found.observed else None,
        "posterior": {k: said["posterior"][k] for k in ("nothing", "unknown")},
        "fit": said["fit"],
        "held_out": errors.distance,
        "farther": errors.farther,
        "floor": errors.floor,
        "diagnosis_seconds": round(took, 1),
    }


def _named(done: Diagnosed) -> Hypothesis:
    """The first set of the answer, about the simulator as given."""
    named = repair_candidates(done.found)[0].fit
    return named if done.case.retuned_from is None else done.case.about_given(named)


def _weigh(config: StacksConfig, output: Path) -> None:
    known = {line["seed"] for line in read(_beside(output))}
    cases = [Case(**line["case"]) for line in read(output) if "failed" not in line]
    left = [case for case in cases if case.seed not in known]
    with (
        tqdm(desc="weighing", total=len(left), unit="case") as bar,
        ProcessPoolExecutor(config.workers, get_context("spawn")) as pool,
    ):
        for job in as_completed([pool.submit(_weighed, config, case) for case in left]):
            bar.update(job.result())


def _weighed(config: StacksConfig, case: Case) -> int:
    """Writes how strongly what is concealed in a case shows; 1, the number of cases."""
    torch.set_num_threads(1)
    folder = Path(config.folder)
    line: dict[str, Any] = {"seed": case.seed}
    try:
        line |= shown(CaseStore(folder, folder / "truth"), case, config.rivals)
    except (ValueError, RuntimeError) as error:  # a drive in too many pieces
        line["failed"] = f"{type(error).__name__}: {error}"
    text = json.dumps(line) + "\n"
    with _beside(Path(config.output)).open("a", buffering=len(text) + 1) as lines:
        lines.write(text)
    return 1


def _answer(line: Mapping[str, Any], weights: Mapping[int, Mapping[str, Any]]) -> WeighedAnswer:
    """A line beside what was weighed of its case."""
    case = Case(**line["case"])
    about = {"status": "answered", "seconds": line["diagnosis_seconds"]}
    stack = {"distance": line["held_out"], "farther": line["farther"], "floor": line["floor"]}
    known = {**weights.get(case.seed, {}), "stack": stack}
    said = {**line, "more_is_missing": line["more"]}
    return answer_of(ScoredCase(case, CaseAnswer.from_diagnosis(said, about)), known)


def summary(cases: Sequence[WeighedAnswer]) -> str:
    """What the cases came to."""
    text = ["| figure | measured | n | aim |", "|---|---|--:|---|"]
    for row in answer_rows(cases):
        aim = "" if row.met is None else "met" if row.met else "**not met**"
        text.append(
            f"| {row.name} | {written(row.figure, row.percent)} | {row.figure.count} | {aim} |"
        )
    text += ["", "| cases | number | gap closed, median | re-tuned | residual | beaten | [s] |"]
    text += ["|---|--:|--:|--:|--:|--:|--:|", *_by_family(cases)]
    beaten = [_told(case) for case in cases if case.stack is not None and case.stack.beaten]
    return "\n".join([*text, "", f"beaten: {', '.join(beaten)}"])


def _by_family(cases: Sequence[WeighedAnswer]) -> Iterator[str]:
    sorts: dict[str, list[WeighedAnswer]] = {}
    for case in cases:
        if case.stack is not None and case.stack.seen:
            make = "own make" if case.scored.case.own_make else "another make"
            for name in (case.family, make):
                sorts.setdefault(name, []).append(case)
    for name, own in sorts.items():
        stacks = [case.stack for case in own if case.stack is not None]
        gaps = (median(s.closed(k) for s in stacks) for k in ("stack", *SIMPLER[1:]))
        took = median(case.scored.answer.seconds for case in own)
        shares = " | ".join(f"{100 * gap:.0f} %" for gap in gaps)
        yield f"| {name} | {len(own)} | {shares} | {sum(s.beaten for s in stacks)} | {took:.0f} |"


def _told(case: WeighedAnswer) -> str:
    assert case.stack is not None
    held = ", ".join(f"{k} {1000 * v:.0f}" for k, v in case.stack.distance.items())
    return f"{case.scored.case.seed} ({held} mm)"


if __name__ == "__main__":
    run(main)
