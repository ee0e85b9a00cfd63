"""Every TensorDict key, spelled once.

Shapes are those after the batch dimensions; units are SI, angles radians, axes ISO 8855
(x forward, y left, z up; yaw and steering positive to the left).
"""

POSE = "pose"  # [3] x, y [m], yaw [rad], world frame
VELOCITY = "velocity"  # [3] vx, vy [m/s], yaw_rate [rad/s], body frame at the tracking sensor
ACTION = "action"  # [2] throttle (-1 is no drive), steering (+1 is full left)

HISTORY = "history"  # [K, 5] velocity and action of the last K steps, a learned engine's memory
OUT_OF_RANGE = "out_of_range"  # [1] bool, a learned engine was asked outside its training range

TIME = "t"  # [1] s, of a recording's row
SEGMENT = "segment"  # int, stretch of a recording without a gap; windows never cross segments
RECORDING = "recording"  # int, index of the drive a window was cut from
ROW = "row"  # int, first row of a window in its drive

REWARD = "reward"
DONE = "done"
TERMINATED = "terminated"
TRUNCATED = "truncated"
