"""A WebSocket client drives as the page does."""

import json
import socket
import time
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from buggy_rl.car.human import HumanConfig, HumanInput
from buggy_rl.car.interfaces import NEUTRAL
from buggy_rl.visual.viewer.control_page import BUSY, UNSUPPORTED, ControlPage
from tests.visual.viewer.client import PATIENCE, Keys, connected, reachable, wait_until


@pytest.fixture
def human():
    return HumanInput(HumanConfig())


@pytest.fixture
def page(human):
    page = ControlPage(human)
    yield page
    page.close()


def test_the_page_is_on_this_machine_only(page):
    # All of 127.0.0.0/8 is this machine; a port open to others would answer there too.
    assert reachable("127.0.0.1", page.port)
    assert not reachable("127.0.0.2", page.port)


def test_a_port_open_to_others_would_be_noticed():
    with socket.create_server(("0.0.0.0", 0)) as server:
        assert reachable("127.0.0.2", server.getsockname()[1])


def test_the_page_holds_the_view_in_its_frame(human):
    page = ControlPage(human, scene="http://127.0.0.1:1234")
    try:
        text = urlopen(page.url).read().decode()
        assert '<iframe src="http://127.0.0.1:1234"' in text
        with pytest.raises(HTTPError, match="404"):
            urlopen(page.url + "other")
    finally:
        page.close()


def test_who_falls_silent_has_no_drive_a_tenth_of_a_second_later(page, human):
    keys = Keys(page, throttle=1, steering=1)
    wait_until(lambda: human.command(0.01)[0] > -0.9)
    keys.fall_silent()
    time.sleep(0.1)
    assert human.command(0.01) == NEUTRAL
    keys.release()


def test_a_page_that_is_closed_has_no_drive_and_another_may_drive(page, human):
    keys = Keys(page, source="gamepad", throttle=1, steering=1)
    wait_until(lambda: human.command(0.01) == (1, 1))
    keys.release()
    wait_until(lambda: human.command(0.01) == NEUTRAL)
    again = Keys(page, source="gamepad", throttle=0.5, steering=0)
    wait_until(lambda: human.command(0.01) == (0.5, 0))
    again.release()


def test_a_second_page_is_sent_away_and_the_first_drives_on(page, human):
    keys = Keys(page, source="gamepad", throttle=1, steering=0)
    wait_until(lambda: human.command(0.01) == (1, 0))
    with connected(page) as second, pytest.raises(ConnectionClosed) as closed:
        second.recv(PATIENCE)
    assert closed.value.rcvd.code == BUSY
    wait_until(lambda: human.command(0.01) == (1, 0))
    keys.release()


def test_nonsense_ends_the_connection_with_the_reason(page):
    with connected(page) as client:
        client.send('{"throttle": 7}')
        with pytest.raises(ConnectionClosed) as closed:
            list(iter(client.recv, None))
    assert closed.value.rcvd.code == UNSUPPORTED
    assert "throttle=7" in closed.value.rcvd.reason


def test_another_website_is_refused(page):
    with pytest.raises(InvalidStatus, match="403"):
        connected(page, origin="http://example.org")
    with connected(page, origin=page.url.rstrip("/")):
        pass  # the page itself is not


def test_enter_starts_and_the_page_hears_how_it_goes(page):
    page.tell(phase="countdown", left=1.5)
    with connected(page) as client:
        assert json.loads(client.recv(PATIENCE)) == {"phase": "countdown", "left": 1.5}
        assert not page.started.is_set()
        client.send('{"start": true}')
        assert page.started.wait(PATIENCE)


def test_the_camera_is_handed_on(human):
    asked = []
    page = ControlPage(human, look=asked.append)
    try:
        with connected(page) as client:
            client.send('{"camera": "top"}')
            wait_until(lambda: asked == ["top"])
    finally:
        page.close()


def test_a_port_that_is_taken_is_named(page, human):
    with pytest.raises(ValueError, match=f"port={page.port}"):
        ControlPage(human, port=page.port)
