"""Looks into a folder of recordings of any car: what is in the tables, what was driven, what lacks.

    python scripts/inspect_recordings.py my_drives/
    python scripts/inspect_recordings.py my_drives/ output=runs/inspection most=10

Writes OUTPUT/inspection.html (one page, needs no other file), inspection.png, and columns.yaml: a
proposed column map, guessed from the data, each guess with its evidence. Nothing reads that map by
itself: check it, edit it, then scripts/check_recordings.py FOLDER columns=THE_MAP.
"""

import sys
from pathlib import Path

from buggy_rl.core.config import from_command_line, run

DEFAULT = "runs/inspection"


def main() -> None:
    """Inspects one folder."""
    folders = [word for word in sys.argv[1:] if "=" not in word and not word.startswith("-")]
    options = [word for word in sys.argv[1:] if word not in folders]
    schema = "buggy_rl.inspection.folder:InspectConfig"
    config = from_command_line(__doc__, schema, options)
    if len(folders) != 1:
        raise ValueError(f"name one folder of recordings, not {len(folders)} (--help says more)")

    from buggy_rl.core.files import write_atomically
    from buggy_rl.figures.inspection import inspection_figure
    from buggy_rl.figures.style import save_figure
    from buggy_rl.inspection.folder import inspect_folder
    from buggy_rl.inspection.page import inspection_page, inspection_panels
    from buggy_rl.jobs.bar import tqdm

    def bar(found):
        return tqdm(found, unit="drive", disable=len(found) < 5)

    found = inspect_folder(Path(folders[0]), config.most, bar)
    output, drawn = Path(config.output or DEFAULT), inspection_panels(found)
    output.mkdir(parents=True, exist_ok=True)
    write_atomically(output / "inspection.html", inspection_page(found, drawn))
    write_atomically(output / "columns.yaml", found.proposal)
    save_figure(inspection_figure(drawn), output / "inspection.png")
    for line in found.first:
        print(line)
    for channel, guess in found.commands.items():
        print(f"{channel}: column {guess.column}: {guess.evidence}")
    for line in found.missing:
        print(f"missing: {line}")
    for note in dict.fromkeys(note for drive in found.drives for note in drive.notes):
        if not any(reason in note for drive in found.drives for reason in drive.reasons.values()):
            print(f"note: {note}")
    if found.missing:
        print("numeric columns of the longest drive: range, rate of change, and what it may be")
    for facts in found.columns if found.missing else ():
        print(f"  {facts.line()}")
    for line in found.suggestions:
        print(f"drive next: {line}")
    print(f"written: {output}/inspection.html, columns.yaml (a proposal: check and edit it)")


if __name__ == "__main__":
    run(main)
