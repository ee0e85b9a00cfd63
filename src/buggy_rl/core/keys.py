"""Every TensorDict key, spelled once.

Shapes are those after the batch dimensions; units are SI, angles radians, axes ISO 8855
(x forward, y left, z up; yaw and steering positive to the left).
"""

POSE = "pose"  # [3] x, y [m], yaw [rad], world frame
VELOCITY = "velocity"  # [3] vx, vy [m/s], yaw_rate [rad/s], body frame at the tracking sensor
ACTION = "action"  # [2] throttle (-1 is no drive), steering (+1 is full left)

HISTORY = "history"  # [K, 5] velocity and action of the last K steps, a learned engine's memory
OUT_OF_RANGE = "out_of_range"  # [1] bool, a learned engine's input is outside its training range
RANGE_EXCESS = "range_excess"  # [1] how far it is beyond that range, in widths of it

TIME = "t"  # [1] s, of a recording's row
SEGMENT = "segment"  # int, stretch of a recording without a gap; windows never cross segments
WHEEL_SPEED = "wheel_speed"  # [1] m/s at the tread, of a recording with wheel odometry
GYRO = "gyro"  # [1] rad/s, yaw rate by a gyroscope, of a recording with an IMU
RECORDING = "recording"  # int, index of the drive a window was cut from
ROW = "row"  # int, first row of a window in its drive

REWARD = "reward"
DONE = "done"
TERMINATED = "terminated"
TRUNCATED = "truncated"

# Of the task.

OBSERVATION = "observation"  # [N] what the policy sees
MEASURED_POSE = "measured_pose"  # [3] the pose as the sensing transforms left it
MEASURED_VELOCITY = "measured_velocity"  # [3] likewise; absent without such a transform
NOISE_STATE = "noise_state"  # [1] int64, position in the environment's stream of noise
VELOCITY_ROWS = "velocity_rows"  # [K, 4] last velocities of the past mean, and 1 where they exist
OBSERVATION_ROWS = "observation_rows"  # [K, N] last observations, oldest first

LAST_ACTION = "last_action"  # [2] command of the step before
SMOOTHED_ACTION = "smoothed_action"  # [2] state of the action smoothing
LIMITED_ACTION = "limited_action"  # [2] state of the rate limit

PATH = "path"  # [1] int64, index of the path in the set
NEXT_WAYPOINT = "next_waypoint"  # [1] int64, increases over the laps of a closed path
WAYPOINTS = "waypoints"  # [10, 2] the next waypoints in the car's frame [m]
WAYPOINTS_CLOSED = "waypoints_closed"  # [1] closed in the last step
PATH_POSITION = "path_position"  # [1] distance along the path from its start [m], over all laps
LATERAL_ERROR = "lateral_error"  # [1] distance from the path [m], positive to its left
HEADING_ERROR = "heading_error"  # [1] yaw against the path's [rad], positive to the left
COMPLETED = "completed"  # [1] bool, an open path has no waypoint left
TARGET_SPEED = "target_speed"  # [1] commanded vx [m/s]

REWARD_TERMS = "reward_terms"  # [T] weighted, in the order of the rewards' configuration
STEP_COUNT = "step_count"  # [1] int64, of the episode

# Of the effects.

ELAPSED = "elapsed"  # [1] s since the battery was charged; a reset may set it, else 0
ENVIRONMENT = "_environment"  # [1] int64, index in the batch; only where a reset is of some
BEYOND = "action_beyond"  # [2] of the command past +-1; only in what an effect hands to the engine
MEMORY = "_memory"  # suffix of the key of an effect's latent state, behind the effect's name
