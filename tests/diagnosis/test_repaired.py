"""The file of a repaired simulator."""

from pathlib import Path
from types import SimpleNamespace

import yaml

from buggy_rl.diagnosis.repaired import repaired_simulator


class NothingInside(dict):
    """A library none of whose effects the simulator has as parameters of its own."""

    def values(self, realised, parameters):
        return parameters


def test_every_effect_of_the_file_can_be_copied_by_itself():
    shared = {"yaw_inertia": 0.0044}
    options = {name: {"dimensions": shared} for name in ("viscous_drag", "rolling_resistance")}
    values = {"viscous_drag": {"rate": 0.2}, "rolling_resistance": {"deceleration": 0.3}}
    problem = SimpleNamespace(
        simulation=SimpleNamespace(options=options),
        library=SimpleNamespace(inside=NothingInside()),
    )
    done = SimpleNamespace(
        step={},
        correction=None,
        case=SimpleNamespace(problem=problem),
        answer=SimpleNamespace(repair=SimpleNamespace(residual=None, values=values)),
    )
    content = repaired_simulator("single_track", done, Path("runs/mine"))
    written = yaml.safe_dump(content, sort_keys=False)
    assert "&" not in written
    assert yaml.safe_load(written)["effects"] == {
        "viscous_drag": {"rate": 0.2, "dimensions": shared},
        "rolling_resistance": {"deceleration": 0.3, "dimensions": shared},
    }
