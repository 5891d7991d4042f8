"""plan.mcap, read back by rosbags: the same numbers as plan.json."""

import json

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

import dexnudge as dn


@pytest.fixture(scope="module")
def saved(crane_plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("mcap") / "PLAN"
    crane_plan.save(folder, pictures=False)
    return folder


@pytest.fixture(scope="module")
def messages(saved):
    with AnyReader([saved / "plan.mcap"]) as reader:
        found = {}
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp, connection.msgtype, message))
    return found


@pytest.fixture(scope="module")
def content(saved):
    return json.loads((saved / "plan.json").read_text())


@pytest.mark.parametrize(
    ("topic", "joints", "effort"),
    [
        ("/joint_trajectory", slice(None), True),
        ("/arm_trajectory", slice(0, 3), False),
        ("/hand_trajectory", slice(3, None), False),
    ],
)
def test_a_trajectory_holds_the_numbers_of_the_json(messages, content, topic, joints, effort):
    [(stamp, kind, message)] = messages[topic]
    assert (stamp, kind) == (0, "trajectory_msgs/msg/JointTrajectory")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (0, 0)  # at once
    assert message.joint_names == content["joint_names"][joints]
    assert len(message.points) == len(content["time"])
    times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in message.points]
    np.testing.assert_allclose(times, content["time"], rtol=0, atol=1e-9)
    for field, key in (("positions", "position"), ("velocities", "velocity"), ("accelerations", "acceleration")):
        values = np.array([getattr(point, field) for point in message.points])
        np.testing.assert_allclose(values, np.array(content[key])[:, joints], rtol=0, atol=1e-9)
    if effort:
        values = np.array([point.effort for point in message.points])
        np.testing.assert_allclose(values, np.array(content["effort"]), rtol=0, atol=1e-9)
    else:
        assert all(len(point.effort) == 0 for point in message.points)


def test_each_phase_is_a_text_where_the_object_is_when_it_starts(messages, content):
    assert len(messages["/phases"]) == len(content["phases"])
    for (stamp, kind, message), phase in zip(messages["/phases"], content["phases"], strict=True):
        assert kind == "visualization_msgs/msg/MarkerArray"
        assert stamp == pytest.approx(phase["start"] * 1e9, abs=1)
        [marker] = message.markers
        assert (marker.text, marker.type, marker.header.frame_id) == (phase["name"], marker.TEXT_VIEW_FACING, "world")
        assert marker.header.stamp.sec + 1e-9 * marker.header.stamp.nanosec == pytest.approx(phase["start"], abs=2e-9)
    at = [message.markers[0].pose.position.x for _, _, message in messages["/phases"]]
    np.testing.assert_allclose(at, [0.0, 0.0, 0.0, 0.0, 0.05], atol=1e-9)


def test_the_file_stands_alone_and_is_the_same_each_time(saved, tmp_path):
    assert sorted(path.name for path in saved.iterdir()) == [
        "README.md",
        "plan.csv",
        "plan.html",
        "plan.json",
        "plan.mcap",
        "robot",
        "scene",
    ]
    dn.load_plan(saved).save(tmp_path / "again", pictures=False)
    assert (tmp_path / "again" / "plan.mcap").read_bytes() == (saved / "plan.mcap").read_bytes()
