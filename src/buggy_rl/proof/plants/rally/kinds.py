"""Unknown effects of the rally car that are drawn as unknown, and those that have a name after all.

A kind has a name where it becomes an effect of the library or a term of its grammar when its own
memory has settled, or for motions slower than its own. One whose memory stays (a film that grows
and is wiped off, a cable that has run out, a gear tooth that catches) has none.
"""

from buggy_rl.proof.plants.rally.unknowns import UNKNOWNS

LIKE_THE_LIBRARY = {
    "controller_heat": "thermal_foldback: drive that heat takes away, here by a threshold",
    "voltage_recovery": "voltage_sag: a loss that goes with the current, here with a memory",
    "cold_grease": "viscous_drag while it lasts: a drag that grows with the speed",
    "shell_lift": "aerodynamic_drag: a drag area, here above a speed",
    "panel_rub": "cornering_drag: braked in bends by the lateral acceleration",
    "kingpin_shimmy": "understeer: wheels turned back by the side force, quicker than 9 Hz alike",
    "whip_mast": "payload: a mass that goes along with all slower than 2.5 Hz",
    "slosh_tank": "payload: likewise, along the car and slower than 1.6 Hz",
    "marker_mast": "term.shown_left.lateral_acceleration: a sensor that roll shifts aside",
    "gyro_warmup": "gyro_bias and heading_drift, 3 s after the start",
}
"""Unknown effect -> what the library or its grammar of terms has, and what is alike.

They can be concealed, but are not drawn: a name would not be wrong.
"""
UNKNOWN = tuple(kind for kind in UNKNOWNS if kind not in LIKE_THE_LIBRARY)
"""Unknown effects that no equation of the library or of its grammar has, in no such limit."""
