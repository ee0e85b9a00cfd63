"""Which OpenGL MuJoCo can draw with here; tried in a subprocess, since a wrong choice is final."""

import os
import subprocess
import sys
from functools import cache

BACKENDS = ("egl", "osmesa", "glfw")
PATIENCE = 60.0  # [s] that a backend has to draw one small frame
PACKAGES = "libegl1 and libgl1 (or libosmesa6)"
TRIAL = """
import mujoco
model = mujoco.MjModel.from_xml_string('<mujoco><worldbody/></mujoco>')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 8, 8) as renderer:
    renderer.update_scene(data)
    renderer.render()
print("drawn", flush=True)
"""


@cache
def backend() -> str:
    """The first that draws: that of MUJOCO_GL if it is set, egl, osmesa or glfw; "" for none.

    `import mujoco` itself fails under a MUJOCO_GL whose library is missing, and never tries again.
    """
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    return next((name for name in ([chosen] if chosen else BACKENDS) if _draws(name)), "")


def _draws(name: str) -> bool:
    environment = {**os.environ, "MUJOCO_GL": name}
    if name == "glfw" and sys.platform == "linux" and not os.environ.get("DISPLAY"):
        return False
    try:
        tried = subprocess.run(
            [sys.executable, "-c", TRIAL],
            env=environment,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
    except subprocess.TimeoutExpired:
        return False
    return "drawn" in tried.stdout


def advice() -> str:
    """What to do where nothing draws."""
    set_ = os.environ.get("MUJOCO_GL")
    tried = f"MUJOCO_GL={set_} does not work" if set_ else "no OpenGL works here"
    return (
        f"{tried}: drawing from above instead. For the rendered car install Debian's {PACKAGES}: "
        "apt-get install libegl1 libgl1"
    )
