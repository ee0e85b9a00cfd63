"""Films of recordings, simulators and policies: track -> shot -> frame -> video.

| module | what it holds |
|---|---|
| `options` | what `scripts/render.py` takes |
| `source`, `rollout` | what a user names -> `track`: where a car was and what it was told |
| `wheels`, `camera` | angles of the wheels; where the picture is taken from |
| `director` | one or two tracks -> a `shot` for each time: numbers only |
| `renderer` | `shot` -> pixels: MuJoCo in another process, or `drawing` on a `canvas` |
| `worker` | the process that renders, with the OpenGL that works |
| `bodywork`, `scene`, `marks` | MuJoCo's model of floor and cars; path and waypoints |
| `inset`, `video` | commands and speed in a corner; mp4, gif and png |
| `film` | tracks -> frames |
| `live`, `pixels` | MuJoCo's viewer; frames for Gymnasium and TorchRL |

Only `bodywork`, `scene`, `worker` and `live` import MuJoCo, and no other imports them before it
needs them. OpenGL is used in the process of `worker` alone, with `MUJOCO_GL` set there and nowhere
else: a process that has imported MuJoCo, as TorchRL does, can no longer choose.
"""
