"""Process that owns an OpenGL context: pickled requests on stdin, pickled answers on stdout.

It is run as a file of its own by `renderer`, with `MUJOCO_GL` set, and imports nothing of ours: a
library that is missing, a driver that crashes or hangs ends this process and no other.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

import os
import pickle
import struct
import sys
from queue import Queue
from threading import Thread
from typing import IO, Any

HEADER = struct.Struct("<Q")  # length of what follows [byte]


def send(stream: IO[bytes], content: Any) -> None:
    """Writes one message."""
    packed = pickle.dumps(content, protocol=5)
    stream.write(HEADER.pack(len(packed)) + packed)
    stream.flush()


def receive(stream: IO[bytes]) -> Any:
    """Reads one message.

    Raises:
        EOFError: The other side has ended.
    """
    header = stream.read(HEADER.size)
    if len(header) < HEADER.size:
        raise EOFError("the renderer's process has ended")
    return pickle.loads(stream.read(HEADER.unpack(header)[0]))


def serve_frames(requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answers a compiled model and a size with a first frame, then each state with its frame.

    None instead of a model and a size stands for an empty world.
    """
    import mujoco
    import numpy as np

    waiting: Queue = Queue()
    # Drained as they come: both sides would wait for ever if both first wrote and then read.
    Thread(target=_drain, args=(requests, waiting), daemon=True).start()
    request = _next(waiting)
    if request is None:
        model, (width, height) = mujoco.MjModel.from_xml_string("<mujoco/>"), (16, 16)
    else:
        content, (width, height) = request
        model = mujoco.MjModel.from_binary_path("film.mjb", {"film.mjb": content})
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    renderer = mujoco.Renderer(model, height, width)
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = True
    mujoco.mj_forward(model, data)
    renderer.update_scene(data)
    send(answers, renderer.render())
    while True:
        state = _next(waiting)
        for name in ("qpos", "mocap_pos", "mocap_quat"):
            getattr(data, name)[:] = state[name]
        mujoco.mj_forward(model, data)
        camera.lookat[:] = state["lookat"]
        camera.distance, camera.azimuth, camera.elevation = state["camera"]
        renderer.update_scene(data, camera)
        for kind, size, position, yaw, rgba in zip(*state["marks"], strict=True):
            cos, sin = np.cos(yaw), np.sin(yaw)
            turn = np.array([cos, -sin, 0, sin, cos, 0, 0, 0, 1])
            geom = renderer.scene.geoms[renderer.scene.ngeom]
            mujoco.mjv_initGeom(geom, kind, size, position, turn, rgba.astype(np.float32))
            renderer.scene.ngeom += 1
        send(answers, renderer.render())


def _drain(requests: IO[bytes], waiting: Queue) -> None:
    """Passes requests on, and at last the EOFError."""
    while True:
        try:
            waiting.put(receive(requests))
        except EOFError as error:
            return waiting.put(error)


def _next(waiting: Queue) -> Any:
    """The next request; raises the EOFError that stands for the end."""
    request = waiting.get()
    if isinstance(request, EOFError):
        raise request
    return request


def main() -> int:
    """Serves until the other side has ended; returns the exit status."""
    own = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not get between the answers
    try:
        serve_frames(sys.stdin.buffer, own)
    except EOFError:
        return 0
    except Exception as error:
        send(own, f"{type(error).__name__}: {error}")
        return 1
    return 0


if __name__ == "__main__":
    os._exit(main())  # no clean-up of contexts that a driver may hang in
