"""Films and drives in a browser, on this machine alone.

| module | what it holds |
|---|---|
| `shapes` | the car of `visual.film.bodywork` as coloured meshes, one set a moving part |
| `stage` | a `Shot` -> viser's scene: car, ghost, floor, path, waypoints, camera |
| `instruments` | time, speed and commands as HTML |
| `choice` | MuJoCo's viewer where there is a screen, else the browser |
| `film_player` | `scripts/render.py live=browser`: play, pause, seek, speed |
| `live_track` | rows of a drive that goes on -> a `Shot` of now |
| `live_window` | the stage of a drive in a process of its own, so that it delays no step |
| `control_page` | the page with keys and gamepad, and the WebSocket they come by |
| `cockpit` | what `scripts/drive.py` sits in: control page and live window |

viser has hotkeys that fire when a key goes down, but no key up and no gamepad; so the control page
is a page of ours that holds viser's in a frame.
"""
