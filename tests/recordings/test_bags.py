"""Bags of other cars: motion capture, Ackermann commands, two publishers, clocks that are set."""

import sqlite3
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from buggy_rl.recordings import ColumnMap, RecordingError, load_recording, load_recordings
from buggy_rl.recordings.columns import SteeringRange, Throttle, Topics
from buggy_rl.recordings.readers.bag_topics import DEFINITIONS, POSE_FIELDS, known_types

START = 1_700_000_000 * 10**9  # [ns]
SECOND = 10**9  # [ns]
HUMBLE = known_types()
NOETIC = get_typestore(Stores.ROS1_NOETIC)
for name, text in DEFINITIONS.items():
    NOETIC.register(get_types_from_msg(text, name))
ACKERMANN = "ackermann_msgs/msg/AckermannDriveStamped"
VECTOR = "geometry_msgs/msg/Vector3Stamped"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
F1TENTH = ColumnMap(
    throttle=Throttle(rest=0.0, full=5.0), steering=SteeringRange(right=-0.4, left=0.4)
)


def message_of(store, kind, row, stamp, ros1=False, frame="map", child="car"):
    """A message of a row, of any type that holds a pose or commands, stamped in ns."""
    types = store.types

    def of(name, *fields, **named):
        return types[name](*fields, **named)

    time = of("builtin_interfaces/msg/Time", stamp // SECOND, stamp % SECOND)
    header = of("std_msgs/msg/Header", **({"seq": 0} if ros1 else {}), stamp=time, frame_id=frame)
    if kind == "std_msgs/msg/Float64":
        return of(kind, row.value)
    if kind == VECTOR:
        return of(kind, header, of("geometry_msgs/msg/Vector3", row.throttle, row.steering, 0.0))
    if kind.startswith("ackermann_msgs"):
        numbers = {"speed": 2.5 * (row.throttle + 1), "steering_angle": 0.4 * row.steering}
        rest = dict.fromkeys(("steering_angle_velocity", "acceleration", "jerk"), 0.0)
        drive = of("ackermann_msgs/msg/AckermannDrive", **numbers, **rest)
        return of(kind, header, drive) if kind.endswith("Stamped") else drive
    if kind == "vesc_msgs/msg/VescStateStamped":
        names = [name for name, _ in store.fielddefs["vesc_msgs/msg/VescState"][1]]
        state = dict.fromkeys(names, 0) | {"speed": 4600.0 * row.vx, "duty_cycle": row.throttle}
        return of(kind, header, of("vesc_msgs/msg/VescState", **state))
    turn = of("geometry_msgs/msg/Quaternion", 0.0, 0.0, np.sin(row.yaw / 2), np.cos(row.yaw / 2))
    if kind == TRANSFORM:
        moved = of("geometry_msgs/msg/Vector3", row.x, row.y, 0.0)
        return of(kind, header, child, of("geometry_msgs/msg/Transform", moved, turn))
    pose = of("geometry_msgs/msg/Pose", of("geometry_msgs/msg/Point", row.x, row.y, 0.0), turn)
    if kind == POSE:
        return of(kind, header, pose)
    covered = of("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
    if kind != ODOMETRY:
        return of(kind, header, covered)
    linear = of("geometry_msgs/msg/Vector3", row.vx, row.vy, 0.0)
    angular = of("geometry_msgs/msg/Vector3", 0.0, 0.0, row.yaw_rate)
    twist = of("geometry_msgs/msg/Twist", linear, angular)
    twist = of("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36))
    return of(kind, header, child, covered, twist)


def rows_of(frame, late=0, every=1, **changed):
    """Rows of a table, each with its stamp and its arrival [ns], `late` after it."""
    for index, row in enumerate(frame.itertuples()):
        if index % every == 0:
            stamp = START + round(row.t * 1e9)
            yield SimpleNamespace(**{**row._asdict(), **changed}), stamp, stamp + late


def write_bag(path, topics, ros1=False, defined=True, mcap=False):
    """Writes a bag.

    Args:
        path: Of the bag.
        topics: (name, type, rows of (row, stamp, arrival), further arguments of `message_of`);
            `name node` gives the publisher of a topic of ROS 1.
        ros1: As a ROS 1 bag.
        defined: Whether the bag defines its types; those of ROS 2 Humble in .db3 do not.
        mcap: Of a ROS 2 bag.
    """
    store = NOETIC if ros1 else HUMBLE
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    writer = Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    connections = {}
    with writer:
        for name, kind, rows, *named in topics:
            topic, _, node = name.partition(" ")
            if name not in connections:
                given = {"callerid": node} if node else {}
                connections[name] = writer.add_connection(topic, kind, typestore=store, **given)
            for row, stamp, arrival in rows:
                message = message_of(store, kind, row, stamp, ros1, *named)
                writer.write(connections[name], arrival, serialize(message, kind))
    if not defined:
        with sqlite3.connect(next(path.glob("*.db3"))) as database:
            database.execute("DELETE FROM message_definitions")
    return path


@pytest.fixture
def frame(make_drive):
    return make_drive(seconds=4.0, noise=2e-4)


def refusal(path, columns=None) -> str:
    with pytest.raises(RecordingError) as caught:
        load_recording(path, columns)
    return str(caught.value)


def follows(recording, frame, shift=0.0):
    """The recording is the drive of the table, its positions moved by `shift` [m] in x."""
    row = np.searchsorted(frame.t, recording.data["t"][:, 0].numpy() - START / 1e9 - 0.005)
    row = row.clip(0, len(frame) - 1)
    assert np.abs(recording.data["pose"][:, 0] - (frame.x.to_numpy()[row] + shift)).max() < 0.03
    assert np.abs(recording.data["velocity"][:, 0] - frame.vx.to_numpy()[row]).max() < 0.2
    # No command exists before the first one, and one grid row may take that of the row before.
    assert np.abs(recording.data["action"][:, 1] - frame.steering.to_numpy()[row]).max() < 0.02


@pytest.mark.parametrize("kind", sorted(POSE_FIELDS))
@pytest.mark.parametrize("version", ["ros1.bag", "db3", "mcap"])
def test_each_type_of_a_pose_is_read_and_velocities_are_derived_where_it_has_none(
    kind, version, frame, tmp_path
):
    topics = [("/pose", kind, rows_of(frame)), ("/cmd", VECTOR, rows_of(frame))]
    path = write_bag(tmp_path / version, topics, ros1="ros1" in version, mcap=version == "mcap")
    recording = load_recording(path)
    follows(recording, frame)
    derived = any("vx, vy, yaw_rate derived" in note for note in recording.notes)
    assert derived == (kind != ODOMETRY)


@pytest.mark.parametrize("kind", ["ackermann_msgs/msg/AckermannDrive", ACKERMANN])
@pytest.mark.parametrize("defined", [True, False])
def test_ackermann_commands_are_read_also_without_their_definition(kind, defined, frame, tmp_path):
    topics = [("/odom", ODOMETRY, rows_of(frame)), ("/drive", kind, rows_of(frame))]
    path = write_bag(tmp_path / "bag", topics, defined=defined)
    recording = load_recording(path, F1TENTH)
    follows(recording, frame)
    assert np.allclose(recording.data["action"][:, 0], frame.throttle, atol=1e-4)
    assert not any("m/s and the angle" in note for note in recording.notes)
    stated = ColumnMap(throttle=F1TENTH.throttle)
    [note] = [n for n in load_recording(path, stated).notes if "m/s and the angle" in n]
    assert "column /drive" in note


def test_a_type_that_nothing_defines_is_refused_by_its_name(frame, tmp_path):
    name = "my_msgs/msg/Servo"
    HUMBLE.register(get_types_from_msg("float64 esc\nfloat64 servo\n", name))
    with Writer2(tmp_path / "bag", version=9) as writer:
        place = writer.add_connection("/pose", POSE, typestore=HUMBLE)
        servo = writer.add_connection("/servo", name, typestore=HUMBLE)
        for row, stamp, arrival in rows_of(frame):
            message = HUMBLE.serialize_cdr(message_of(HUMBLE, POSE, row, stamp), POSE)
            writer.write(place, arrival, message)
            message = HUMBLE.types[name](row.throttle, row.steering)
            writer.write(servo, arrival, HUMBLE.serialize_cdr(message, name))
    columns = ColumnMap(topics=Topics(action="/servo"))
    error = refusal(tmp_path / "bag", columns)
    assert "two of its numbers, under topics.action_fields; it has esc, servo" in error
    assert "0 topics can be the action; name the topic under topics.action" in refusal(
        tmp_path / "bag"
    )
    named = ColumnMap(topics=Topics(action="/servo", action_fields=["esc", "servo"]))
    follows(load_recording(tmp_path / "bag", named), frame)  # the remedy works
    with sqlite3.connect(next((tmp_path / "bag").glob("*.db3"))) as database:
        database.execute("DELETE FROM message_definitions")
    assert "no definition of my_msgs/msg/Servo" in refusal(tmp_path / "bag", named)


def test_a_topic_without_a_pose_is_told_from_one_of_the_commands(frame, tmp_path):
    topics = [("/pose", POSE, rows_of(frame)), ("/cmd", VECTOR, rows_of(frame))]
    path = write_bag(tmp_path / "bag", topics)
    error = refusal(path, ColumnMap(topics=Topics(odometry="/cmd")))
    assert "holds no pose" in error
    assert "topics.action_fields" not in error
    assert "/pose (geometry_msgs/msg/PoseStamped)" in error


@pytest.mark.parametrize("ending", [".mcap", ".db3"])
def test_a_file_of_a_bag_is_read_without_its_folder(ending, frame, tmp_path):
    topics = [("/pose", POSE, rows_of(frame)), ("/cmd", VECTOR, rows_of(frame))]
    bag = write_bag(tmp_path / "bag", topics, mcap=ending == ".mcap")
    for name in ("one", "two"):
        (tmp_path / "alone").mkdir(exist_ok=True)
        content = next(bag.glob(f"*{ending}")).read_bytes()
        (tmp_path / "alone" / f"{name}{ending}").write_bytes(content)
    follows(load_recording(tmp_path / "alone" / f"one{ending}"), frame)
    recordings, refusals = load_recordings(tmp_path / "alone")
    assert ([r.name for r in recordings], refusals) == (["one", "two"], [])
    assert "2 files without metadata.yaml" in refusal(tmp_path / "alone")
    (tmp_path / "alone" / f"two{ending}").unlink()
    follows(load_recording(tmp_path / "alone"), frame)


def test_commands_in_a_topic_each_are_named_with_their_topics(frame, tmp_path):
    def single(channel, late):
        for row, stamp, arrival in rows_of(frame, late):
            yield SimpleNamespace(value=getattr(row, channel)), stamp, arrival

    topics = [
        ("/pose", POSE, rows_of(frame)),
        ("/motor", "std_msgs/msg/Float64", single("throttle", 0)),
        ("/servo", "std_msgs/msg/Float64", single("steering", 30_000_000)),
    ]
    path = write_bag(tmp_path / "bag", topics)
    assert 'action_fields: ["/topic:field", "/topic:field"]' in refusal(path)
    named = ColumnMap(topics=Topics(action_fields=["/motor:data", "/servo:data"]))
    recording = load_recording(path, named)
    assert len(recording) == len(frame) - 3  # the servo's first command comes 30 ms late
    action = recording.data["action"].numpy()
    assert np.allclose(action[:, 0], frame.throttle[3:], atol=1e-6)
    assert np.allclose(action[:, 1], frame.steering[:-3], atol=1e-6)


def test_the_motor_speed_of_a_vesc_is_a_wheel_speed(frame, tmp_path):
    vesc = "vesc_msgs/msg/VescStateStamped"
    topics = [
        ("/pose", POSE, rows_of(frame)),
        ("/cmd", VECTOR, rows_of(frame)),
        ("/sensors/core", vesc, rows_of(frame, every=2)),
    ]
    path = write_bag(tmp_path / "bag", topics, defined=False)
    wheel = load_recording(path).data["wheel_speed"][:, 0].numpy()
    assert np.nanmax(np.abs(wheel - 4600 * frame.vx)) < 4600 * 0.05
    fields = ["/sensors/core:state.duty_cycle", "/cmd:vector.y"]
    recording = load_recording(path, ColumnMap(topics=Topics(action_fields=fields)))
    assert np.abs(recording.data["action"][:, 0].numpy() - frame.throttle).max() < 0.05


def test_odometry_beside_another_pose_is_read_and_the_other_is_said(frame, tmp_path):
    moved = frame.assign(x=frame.x + 0.3)
    topics = [
        ("/odom", ODOMETRY, rows_of(frame)),
        ("/vicon", TRANSFORM, rows_of(moved)),
        ("/cmd", VECTOR, rows_of(frame)),
    ]
    path = write_bag(tmp_path / "bag", topics)
    recording = load_recording(path)
    follows(recording, frame)
    assert any("/vicon can be it too: if so, name it" in note for note in recording.notes)
    named = load_recording(path, ColumnMap(topics=Topics(odometry="/vicon")))
    follows(named, frame, shift=0.3)


def test_two_nodes_of_one_topic_are_refused_and_one_can_be_chosen(frame, tmp_path):
    moved = frame.assign(x=frame.x + 0.3)
    topics = [
        ("/odom /pf", ODOMETRY, rows_of(moved, late=3_000_000)),
        ("/odom /vesc_to_odom", ODOMETRY, rows_of(frame)),
        ("/cmd /joy", VECTOR, rows_of(frame)),
    ]
    path = write_bag(tmp_path / "two.bag", topics, ros1=True)
    error = refusal(path)
    assert "2 publish this topic at the same time: '/pf' (400 messages)" in error
    assert "'/vesc_to_odom' (400 messages)" in error
    for source, shift in (("/pf", 0.3), ("/vesc_to_odom", 0.0)):
        columns = ColumnMap(topics=Topics(odometry_source=source))
        follows(load_recording(path, columns), frame, shift)
    wrong = ColumnMap(topics=Topics(odometry_source="/amcl"))
    assert "no message is of '/amcl'; correct topics.odometry_source" in refusal(path, wrong)


def test_two_frames_of_one_topic_are_told_apart(frame, tmp_path):
    moved = frame.assign(x=frame.x + 0.3)
    topics = [
        ("/pose", TRANSFORM, rows_of(frame), "world", "car"),
        ("/pose", TRANSFORM, rows_of(moved, late=3_000_000), "world", "wand"),
        ("/cmd", VECTOR, rows_of(frame)),
    ]
    path = write_bag(tmp_path / "bag", topics)
    assert "topics: {odometry_source: 'car'}" in refusal(path)
    follows(load_recording(path, ColumnMap(topics=Topics(odometry_source="car"))), frame)


@pytest.mark.parametrize("every", [1, 4])
def test_two_nodes_that_nothing_tells_apart_are_refused_by_their_paths(every, frame, tmp_path):
    moved = frame.assign(x=frame.x + 0.3)
    topics = [
        ("/pose", POSE, rows_of(frame)),
        ("/pose", POSE, rows_of(moved, late=3_000_000, every=every)),
        ("/cmd", VECTOR, rows_of(frame)),
    ]
    error = refusal(write_bag(tmp_path / "bag", topics))
    assert "positions alternate between two paths 0.3 m apart" in error


def test_a_node_that_starts_anew_is_no_second_one(frame, tmp_path):
    half = len(frame) // 2
    topics = [
        ("/pose /mocap_1", POSE, rows_of(frame[:half])),
        ("/pose /mocap_2", POSE, rows_of(frame[half:])),
        ("/cmd", VECTOR, rows_of(frame)),
    ]
    follows(load_recording(write_bag(tmp_path / "b.bag", topics, ros1=True)), frame)


@pytest.mark.parametrize("seconds", [-2.5, 1_000_000.0])
def test_a_clock_that_is_set_goes_on_with_the_arrival(seconds, frame, tmp_path):
    def rows(late):
        for row, stamp, arrival in rows_of(frame, late):
            moved = round(seconds * 1e9) if row.t >= 2.0 else 0
            yield row, stamp + moved, arrival

    topics = [("/pose", POSE, rows(2_000_000)), ("/cmd", VECTOR, rows(1_000_000))]
    recording = load_recording(write_bag(tmp_path / "bag", topics))
    assert len(recording) == pytest.approx(len(frame), abs=2)
    follows(recording, frame)
    does = "back by 2.5 s" if seconds < 0 else "forward by 1e+06 s"
    notes = [note for note in recording.notes if f"was set {does}" in note]
    assert [note.split(":")[0] for note in notes] == [
        "row 200, column /pose",
        "row 200, column /cmd",
    ]


def test_messages_out_of_order_are_put_in_order(frame, tmp_path):
    rows = [*rows_of(frame)]
    (a, stamp, arrival), (b, later, after) = rows[100:102]
    rows[100:102] = [(b, later, arrival), (a, stamp, after)]
    topics = [("/pose", POSE, rows), ("/cmd", VECTOR, rows_of(frame))]
    recording = load_recording(write_bag(tmp_path / "bag", topics))
    assert len(recording) == len(frame)
    follows(recording, frame)


def test_messages_that_are_there_twice_are_read_once_and_said(frame, tmp_path):
    twice = [row for row in rows_of(frame) for _ in range(2)]
    topics = [("/pose", POSE, twice), ("/cmd", VECTOR, rows_of(frame))]
    recording = load_recording(write_bag(tmp_path / "bag", topics))
    assert len(recording) == len(frame)
    follows(recording, frame)
    assert any("400 messages have the stamp of the one before: cut" in n for n in recording.notes)


def test_stamps_in_whole_seconds_are_replaced_by_the_arrival(frame, tmp_path):
    def whole():
        for row, stamp, arrival in rows_of(frame):
            yield row, stamp // SECOND * SECOND, arrival

    topics = [("/pose", POSE, whole()), ("/cmd", VECTOR, rows_of(frame))]
    recording = load_recording(write_bag(tmp_path / "bag", topics))
    follows(recording, frame)
    assert any("stamps are not used" in note for note in recording.notes)
