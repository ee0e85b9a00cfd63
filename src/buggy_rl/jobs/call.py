"""Calls the function that lies in a job's folder: python -m buggy_rl.jobs.call FOLDER."""

import json
import os
import pickle
import sys
from pathlib import Path

from buggy_rl.core.files import write_atomically
from buggy_rl.jobs.calls import CALL, RESULT


def main(folder: Path) -> None:
    """Reads function and arguments, writes the result."""
    path, call = pickle.loads((folder / CALL).read_bytes())
    sys.path += [place for place in path if place not in sys.path]
    function, arguments = pickle.loads(call)
    write_atomically(folder / RESULT, json.dumps(function(*arguments), default=os.fspath))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
