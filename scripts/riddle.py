"""Conceals physics in a car, asks the diagnosis what it is, then opens the sealed answer.

    python scripts/riddle.py output=runs/riddle
    python scripts/riddle.py output=runs/riddle_7 seed=7 effects=2

What is concealed is drawn at random, on your machine: nobody knows it before the answer is opened.
The simulator is the reference car without it, as a black box. Writes OUTPUT/riddle.png (a sealed
drive: the car, the simulator as given, the simulator repaired) and what scripts/diagnose.py writes.
Started again, it goes on with the riddle that is there.
"""

import shutil
import subprocess
import sys
from pathlib import Path

from buggy_rl.config import from_command_line, run

NAMELESS = {  # what an answer without a name says
    "no_mismatch": "that nothing is missing",
    "unknown_physics": "that something is missing that it has no name for",
    "cannot_tell": "that these drives cannot tell",
}


def main() -> None:
    """Seals, asks, opens."""
    config = from_command_line(__doc__, "buggy_rl.blind_test.blind_demo:RiddleConfig")

    import json

    import torch

    from buggy_rl.blind_test.blind_demo import MEASURED, distance, riddle, rollouts
    from buggy_rl.blind_test.exam import write_json
    from buggy_rl.blind_test.sealing import publish, seal
    from buggy_rl.effects import effect_class
    from buggy_rl.viz import rollout_figure

    torch.set_num_threads(1)
    vault, case = config.vault, riddle(config)
    seen, said = vault.seen(case.id), vault.said(case.id)
    if not vault.answer(case.id).exists():
        print(
            f"driving a car in which something is concealed, {config.seconds:g} s ...", flush=True
        )
        seal(vault, [case], [], secret=str(torch.seed()))
    publish(vault, [case])
    digest = vault.hashes.read_text().split()[0]
    print(f"sealed: {vault.answer(case.id)}, SHA-256 {digest}", flush=True)

    if not (said / "outcome.json").exists():
        script = Path(__file__).resolve().parent / "diagnose.py"
        asked = ["question.yaml", f"output={said.resolve()}", *config.more]
        if subprocess.run([sys.executable, str(script), *asked], cwd=seen).returncode:
            raise RuntimeError("the diagnosis did not finish: the lines above say why")
        write_json(said / "outcome.json", {"status": "answered"})

    truth = vault.cases()[0].concealed  # checks the hash
    answer = json.loads((said / "diagnosis.json").read_text())
    names = [effect["name"] for effect in answer["effects"]]
    print(f"\nThe sealed answer, unchanged ({digest[:12]}...):")
    for name, values in truth.items():
        numbers = ", ".join(f"{parameter} {value:g}" for parameter, value in values.items())
        sentence = effect_class(name).sentence(values)
        print(f"  {sentence[:1].upper()}{sentence[1:]} [{name}: {numbers}].")
    if not truth:
        print("  Nothing was concealed.")
    right = set(names) == set(truth) if len(truth) != 1 else names[:1] == list(truth)
    said_so = ", ".join(names) or NAMELESS.get(answer["verdict"], "nothing")
    print(f"The diagnosis said {said_so}: {'right' if right else 'wrong'}.")

    shown = rollouts(vault, case)
    measured = shown.pop(MEASURED)
    off = {name: 1000 * distance(made, measured) for name, made in shown.items()}
    print(
        "A drive it has not seen, after 1 s: "
        + ", ".join(f"{value:.0f} mm off {name}" for name, value in off.items())
        + "."
    )
    picture = vault.output / "riddle.png"
    rollout_figure(measured, shown).savefig(picture, dpi=110)
    page = vault.output / "report.html"
    shutil.copyfile(said / page.name, page)
    # The repaired simulator names the one it repairs by where both lie: it stays there.
    print(f"written: {picture}, {page}; the simulator: {said / 'repaired.yaml'}")


if __name__ == "__main__":
    run(main)
