"""Conceals physics in a car, diagnoses it, then shows the sealed answer.

    python scripts/blind_demo.py output=runs/blind_demo
    python scripts/blind_demo.py output=runs/blind_demo_7 seed=7 effects=2

What is concealed is drawn at random, on your machine: nobody knows it before the answer is shown.
The simulator is the reference car without it, as a black box. Writes OUTPUT/blind_demo.png (a
held-out drive: the car, the simulator as given, the simulator repaired) and what
scripts/diagnose.py writes. Started again, it goes on with the case that is there.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from buggy_rl.core.config import from_command_line, run

NAMELESS = {  # an answer without a name, by verdict
    "no_mismatch": "that nothing is missing",
    "unknown_physics": "that something is missing that it has no name for",
    "cannot_tell": "that these drives cannot tell",
}


def main() -> None:
    """Seals a case, diagnoses it, shows both answers and a held-out drive."""
    config = from_command_line(__doc__, "buggy_rl.proof.blind_demo:BlindDemoConfig")

    import json

    import torch

    from buggy_rl.commands.compile import at_first_use
    from buggy_rl.proof.blind_demo import draw_case
    from buggy_rl.proof.cases.sealing import publish, seal

    torch.set_num_threads(1)
    at_first_use("reference")
    store, case = config.store, draw_case(config)
    if not store.truth(case.id).exists():
        print(
            f"driving a car in which something is concealed, {config.seconds:g} s ...", flush=True
        )
        seal(store, [case], [], secret=str(torch.seed()))
    publish(store, [case])
    digest = store.digests()[case.id]
    print(f"sealed: {store.truth(case.id)}, SHA-256 {digest}", flush=True)
    _diagnose(store, case.id, config.more)
    truth = store.sealed_case(case.id).concealed  # checks the hash
    print(f"\nThe sealed answer, unchanged ({digest[:12]}...):")
    _compare(truth, json.loads((store.diagnosis(case.id) / "diagnosis.json").read_text()))
    _draw(store, case)


def _diagnose(store, id_: str, more: list[str]) -> None:
    """Runs scripts/diagnose.py beside the drives, unless that was done before."""
    from buggy_rl.core.files import write_json
    from buggy_rl.jobs import OUTCOME

    if store.diagnosed(id_):
        return
    folder = store.diagnosis(id_).resolve()
    command = [sys.executable, "-m", "buggy_rl", "diagnose"]
    command += ["question.yaml", f"output={folder}", *more]
    # Modules are found from the other working directory as they are from here.
    path = os.pathsep.join(str(Path(place).resolve()) for place in sys.path)
    environment = os.environ | {"PYTHONPATH": path}
    if subprocess.run(command, cwd=store.inputs(id_), env=environment).returncode:
        raise SystemExit("error: the diagnosis did not finish; the lines above say why")
    write_json(folder / OUTCOME, {"status": "done"})


def _compare(truth: dict[str, dict[str, float]], answer: dict) -> None:
    """Prints what was concealed, and whether the diagnosis is right."""
    from buggy_rl.effects import effect_class

    for name, values in truth.items():
        numbers = ", ".join(f"{parameter} {value:g}" for parameter, value in values.items())
        sentence = effect_class(name).sentence(values)
        print(f"  {sentence[:1].upper()}{sentence[1:]} [{name}: {numbers}].")
    if not truth:
        print("  Nothing was concealed.")
    names = [effect["name"] for effect in answer["effects"]]
    right = set(names) == set(truth) if len(truth) != 1 else names[:1] == list(truth)
    said = ", ".join(names) or NAMELESS.get(answer["verdict"], "nothing")
    print(f"The diagnosis said {said}: {'right' if right else 'wrong'}.")


def _draw(store, case) -> None:
    """Draws the held-out drive and the simulators' rollouts of it."""
    from buggy_rl.figures.models import rollout_figure
    from buggy_rl.proof.blind_demo import MEASURED, demo_rollouts, position_error

    shown = demo_rollouts(store, case)
    measured = shown.pop(MEASURED)
    off = [
        f"{1000 * position_error(made, measured):.0f} mm off {name}" for name, made in shown.items()
    ]
    print(f"A drive it was not given, after 1 s: {', '.join(off)}.")
    picture, page = store.output / "blind_demo.png", store.output / "report.html"
    rollout_figure(measured, shown).savefig(picture, dpi=110)
    shutil.copyfile(store.diagnosis(case.id) / page.name, page)
    # The repaired simulator names the one it repairs by a relative path: it is not moved.
    repaired = store.diagnosis(case.id) / "repaired.yaml"
    print(f"written: {picture}, {page}; the simulator: {repaired}")


if __name__ == "__main__":
    run(main)
