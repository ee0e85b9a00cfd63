"""Each kind of file, written by the library that writes real ones."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from buggy_rl.recordings import ColumnMap, RecordingError, load_recording
from buggy_rl.recordings.columns import Topics

SECONDS = 4.0


@pytest.fixture
def frame(make_drive):
    return make_drive(seconds=SECONDS, noise=2e-4)


def same_drive(recording, frame):
    """The recording holds the rows of the frame."""
    data = recording.data
    assert len(recording) == len(frame)
    for key, names in {
        "velocity": ["vx", "vy", "yaw_rate"],
        "action": ["throttle", "steering"],
    }.items():
        expected = torch.tensor(frame[names].to_numpy(np.float32))
        torch.testing.assert_close(data[key], expected, atol=1e-6, rtol=0)
    assert np.allclose(data["pose"][:, :2], frame[["x", "y"]], atol=1e-6)
    assert np.allclose(np.cos(data["pose"][:, 2] - frame.yaw.to_numpy()), 1.0, atol=1e-6)


def refusal(path, **keywords) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        load_recording(path, **keywords)
    return caught.value


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_csv_is_read_with_any_separator(separator, frame, tmp_path):
    frame.to_csv(tmp_path / "drive.csv", sep=separator, index=False)
    recording = load_recording(tmp_path / "drive.csv")
    same_drive(recording, frame)
    assert recording.name == "drive"


def test_extra_columns_and_their_order_do_not_matter(frame, write):
    shuffled = frame[frame.columns[::-1]].assign(comment="text", lap=1)
    same_drive(load_recording(write(shuffled)), frame)


def test_parquet_is_read(frame, tmp_path):
    frame.to_parquet(tmp_path / "drive.parquet")
    same_drive(load_recording(tmp_path / "drive.parquet"), frame)


@pytest.mark.parametrize(
    ("content", "words"),
    [("", "empty"), ("\n\n", "empty"), ("t,x,y\n", "no row"), ("\xff\xfe\x00", "UTF-8")],
)
def test_an_empty_csv_is_refused(content, words, tmp_path):
    (tmp_path / "drive.csv").write_bytes(content.encode("latin-1"))
    assert words in str(refusal(tmp_path / "drive.csv"))


def test_a_last_line_that_is_cut_off_is_left_out_and_named(frame, write):
    path = write(frame)
    path.write_bytes(path.read_bytes()[:-30])
    recording = load_recording(path)
    assert len(recording) == len(frame) - 1
    assert "row 399, column steering: the file is cut off" in recording.notes[0]


def test_a_last_line_without_an_end_is_left_out_and_named(frame, write):
    path = write(frame)
    path.write_bytes(path.read_bytes()[:-3])
    recording = load_recording(path)
    assert len(recording) == len(frame) - 1
    assert "row 399" in recording.notes[0]


def test_a_line_with_too_many_cells_is_refused_by_its_row(frame, write):
    path = write(frame)
    lines = path.read_text().splitlines()
    lines[101] += ",1"
    path.write_text("\n".join(lines) + "\n")
    error = refusal(path)
    assert error.row == 100
    assert "more cells than the header" in str(error)


def test_a_line_with_too_few_cells_is_refused_by_its_row_and_column(frame, write):
    path = write(frame)
    lines = path.read_text().splitlines()
    lines[101] = lines[101].rsplit(",", 1)[0]
    path.write_text("\n".join(lines) + "\n")
    error = refusal(path)
    assert (error.row, error.column) == (100, "steering")


@pytest.mark.parametrize("share", [0.0, 0.5, 0.98])
def test_a_parquet_file_that_is_cut_off_is_refused(share, frame, tmp_path):
    path = tmp_path / "drive.parquet"
    frame.to_parquet(path)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    assert str(path) in str(refusal(path))


@pytest.fixture
def npy_folder(frame, tmp_path):
    folder = tmp_path / "drive_7"
    folder.mkdir()
    half, zero = frame.yaw / 2, 0 * frame.yaw
    arrays = {
        "positions": [frame.x, frame.y, zero + 0.05],
        "orientation": [np.cos(half), zero, zero, np.sin(half)],
        "linear": [frame.vx, frame.vy, zero],
        "angular": [zero, zero, frame.yaw_rate],
        "actions": [frame.throttle, frame.steering],
    }
    for name, columns in arrays.items():
        np.save(folder / f"{name}.npy", np.stack(columns, -1))
    return folder


def test_a_folder_of_npy_is_read_at_100_hz(npy_folder, frame):
    recording = load_recording(npy_folder)
    same_drive(recording, frame)
    assert recording.name == "drive_7"
    assert "100 Hz assumed" in recording.notes[0]


def test_time_stamps_of_a_npy_folder_are_used(npy_folder, frame):
    np.save(npy_folder / "timestamp.npy", frame.t.to_numpy() * 2)  # 50 Hz
    error = refusal(npy_folder)  # at half the speed position and velocity disagree
    assert error.column == "linear[0]"
    np.save(npy_folder / "timestamp.npy", frame.t.to_numpy() + 7)
    assert load_recording(npy_folder).data["t"][0] == 7


def test_velocities_of_a_npy_folder_may_be_missing(npy_folder):
    (npy_folder / "linear.npy").unlink()
    (npy_folder / "angular.npy").unlink()
    assert "vx, vy, yaw_rate derived" in load_recording(npy_folder).notes[-1]


def test_pickled_arrays_are_refused_and_never_run(npy_folder, tmp_path):
    class Attack:
        def __reduce__(self):
            return (open, (str(tmp_path / "owned"), "w"))

    np.save(npy_folder / "actions.npy", np.array([Attack()]), allow_pickle=True)
    error = refusal(npy_folder)
    assert error.column == "actions"
    assert "pickled" in str(error)
    assert not (tmp_path / "owned").exists()


def test_npy_arrays_that_do_not_fit_are_refused_by_name(npy_folder):
    actions = np.load(npy_folder / "actions.npy")
    np.save(npy_folder / "actions.npy", actions[:-3])
    error = refusal(npy_folder)
    assert (error.row, error.column) == (397, "actions")
    np.save(npy_folder / "actions.npy", actions[:, 0])
    assert "[rows, 2 or more]" in str(refusal(npy_folder))
    (npy_folder / "actions.npy").write_bytes(b"\x93NUMPY")
    assert refusal(npy_folder).column == "actions"
    (npy_folder / "actions.npy").unlink()
    assert "available: angular, linear, orientation, positions" in str(refusal(npy_folder))


ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
START = 1_700_000_000 * 10**9  # [ns]


def odometry(store, row, stamp, ros1):
    """An Odometry message of a row, stamped in ns."""
    types = store.types
    header = {"seq": 0} if ros1 else {}
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    quaternion = types["geometry_msgs/msg/Quaternion"]
    time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
    covariance = np.zeros(36)
    pose = types["geometry_msgs/msg/Pose"](
        point(row.x, row.y, 0.0), quaternion(0.0, 0.0, np.sin(row.yaw / 2), np.cos(row.yaw / 2))
    )
    twist = types["geometry_msgs/msg/Twist"](
        vector(row.vx, row.vy, 0.0), vector(0.0, 0.0, row.yaw_rate)
    )
    return types["nav_msgs/msg/Odometry"](
        header=types["std_msgs/msg/Header"](**header, stamp=time, frame_id="map"),
        child_frame_id="base",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose, covariance),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](twist, covariance),
    )


def action(store, kind, throttle, steering):
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"]
    if kind == "std_msgs/msg/Float32MultiArray":
        layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
        return types[kind](layout, np.array([throttle, steering], np.float32))
    if kind == "geometry_msgs/msg/Twist":
        return types[kind](vector(throttle, 0.0, 0.0), vector(0.0, 0.0, steering))
    return types[kind](throttle, steering, 0.0)


def write_bag(path, frame, kind, ros1, every=1, late=0, second=False, mcap=False):
    """Writes a bag: odometry a row; a command each `every` rows, `late` ns after the row."""
    store = ROS1 if ros1 else ROS2
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    writer = Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    with writer:
        places = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
        commands = writer.add_connection("/cmd", kind, typestore=store)
        other = writer.add_connection("/other", kind, typestore=store) if second else None
        for index, row in enumerate(frame.itertuples()):
            stamp = START + round(row.t * 1e9)
            if index % every == 0:
                message = serialize(action(store, kind, row.throttle, row.steering), kind)
                writer.write(commands, stamp + late, message)
                if other:
                    writer.write(other, stamp, message)
            message = odometry(store, SimpleNamespace(**row._asdict()), stamp, ros1)
            writer.write(places, stamp + 2_000_000, serialize(message, "nav_msgs/msg/Odometry"))
    return path


KINDS = ["geometry_msgs/msg/Vector3", "std_msgs/msg/Float32MultiArray", "geometry_msgs/msg/Twist"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("version", ["ros1.bag", "ros2", "ros2 mcap"])
def test_bags_are_read_with_stamps_of_the_odometry(version, kind, frame, tmp_path):
    path = tmp_path / version
    write_bag(path, frame, kind, ros1=version == "ros1.bag", mcap="mcap" in version)
    recording = load_recording(path)
    same_drive(recording, frame)
    assert recording.data["t"][0] == pytest.approx(START * 1e-9, abs=1e-6)


def test_a_command_holds_from_its_own_stamp_on(frame, tmp_path):
    # one command each 5 rows, 1 ms after the row: row 0 has none yet, rows 1-5 have that of row 0
    path = write_bag(tmp_path / "held", frame, KINDS[0], ros1=False, every=5, late=10**6)
    recording = load_recording(path)
    assert len(recording) == len(frame) - 1
    expected = frame.steering.to_numpy()[(np.arange(len(frame) - 1) // 5) * 5]
    assert np.allclose(recording.data["action"][:, 1], expected, atol=1e-6)
    assert "first 1 rows, column /cmd: no command yet" in recording.notes[0]


def test_an_ambiguous_topic_is_refused_and_can_be_named(frame, tmp_path):
    path = write_bag(tmp_path / "two", frame, KINDS[0], ros1=False, second=True)
    error = str(refusal(path))
    assert "2 topics can be the action" in error
    assert "/cmd (geometry_msgs/msg/Vector3), /odom" in error
    named = ColumnMap(topics=Topics(action="/other", action_fields=["y", "x"]))
    recording = load_recording(path, columns=named)
    assert np.allclose(recording.data["action"][:, 0], frame.steering, atol=1e-6)
    assert "no topic /missing" in str(
        refusal(path, columns=ColumnMap(topics=Topics(action="/missing")))
    )
    fields = ColumnMap(topics=Topics(action="/cmd", action_fields=["x", "data[0]"]))
    assert "the message has no x, data[0]" in str(refusal(path, columns=fields))


def test_a_fault_in_a_bag_is_named_by_topic_and_message(frame, tmp_path):
    frame.loc[50, "steering"] = 3.0
    error = refusal(write_bag(tmp_path / "bad.bag", frame, KINDS[0], ros1=True))
    assert (error.row, error.column) == (50, "/cmd.y")


def test_a_bag_that_is_cut_off_is_refused(frame, tmp_path):
    path = write_bag(tmp_path / "cut.bag", frame, KINDS[0], ros1=True)
    path.write_bytes(path.read_bytes()[:20_000])
    assert "cannot be read" in str(refusal(path))
    folder = write_bag(tmp_path / "cut", frame, KINDS[0], ros1=False)
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9}\n")
    assert "metadata" in str(refusal(folder))
