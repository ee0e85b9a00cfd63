"""Stands in for the browser: sends what the control page sends."""

import json
import socket
import threading
import time

from websockets.sync.client import connect

from buggy_rl.visual.viewer.control_page import HOST

PATIENCE = 60.0  # [s] for a machine that is busy


def connected(page, **options):
    return connect(f"ws://{HOST}:{page.port}/controls", **options)


def wait_until(fact):
    end = time.monotonic() + PATIENCE
    while not fact():
        assert time.monotonic() < end
        time.sleep(0.002)


class Keys:
    """Holds the same keys from the first message to `release`."""

    def __init__(self, page, **controls):
        self._socket, self._going = connected(page), True
        self._message = json.dumps(controls)
        self._thread = threading.Thread(target=self._send)
        self._thread.start()

    def _send(self):
        while self._going:
            self._socket.send(self._message)
            time.sleep(0.01)

    def fall_silent(self):
        self._going = False
        self._thread.join()

    def release(self):
        self.fall_silent()
        self._socket.close()


def reachable(address, port):
    with socket.socket() as caller:
        return caller.connect_ex((address, port)) == 0
