"""Says where a simulator and drives differ, what physics is missing, and gives back the simulator.

    python scripts/diagnose.py simulator=fitted.yaml recordings=[drives/] output=runs/diagnosis
    python scripts/diagnose.py simulator=my.py:make recordings=[new/] baseline=[old/] output=runs/d

Writes OUTPUT/diagnosis.json, repaired.yaml (which every script takes as a simulator), report.html.
"""

from pathlib import Path

from buggy_rl.config import from_command_line, run, save_run


def main() -> None:
    """Diagnoses and writes."""
    config = from_command_line(__doc__, "buggy_rl.diagnosis.pipeline:DiagnosisConfig")

    import json

    import torch
    import yaml
    from tqdm import tqdm

    from buggy_rl.diagnosis.pipeline import diagnose, repaired
    from buggy_rl.recordings import load_recordings

    torch.set_num_threads(config.threads)
    recordings, refusals = load_recordings(config.recordings, config.columns or None)
    for refusal in refusals:
        tqdm.write(f"refused: {refusal}")
    if not recordings:
        raise ValueError("no drive is left to look at: the lines above say why")
    folder = Path(config.output)
    save_run(config, folder)
    with tqdm(bar_format="{elapsed} {desc}") as bar:
        answer = diagnose(config, recordings, bar.set_description_str)
    (folder / "diagnosis.json").write_text(json.dumps(answer.to_dict(), indent=2) + "\n")
    content = repaired(config.simulator, answer, folder)
    (folder / "repaired.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    print("\n".join(answer.lines()))
    print(f"written: {folder / 'diagnosis.json'}, {folder / 'repaired.yaml'}")


if __name__ == "__main__":
    run(main)
