"""plan.mcap: a plan for ROS 2, by rosbags, which needs no ROS."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.trajectories.plan import JointTrajectory, Plan

TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
MARKERS = "visualization_msgs/msg/MarkerArray"
WHOLE, ARM, HAND, PHASES = "/joint_trajectory", "/arm_trajectory", "/hand_trajectory", "/phases"
FRAME = "world"
TEXT_HEIGHT = 0.03  # [m] of a phase's name
ABOVE = 0.10  # [m] from the object's origin
TEXT = 9  # visualization_msgs/Marker: TEXT_VIEW_FACING
SECOND = 10**9  # [ns]


def write_mcap(plan: Plan, trajectory: JointTrajectory, path: Path) -> None:
    """Write what a ROS 2 player or controller takes; the same plan gives the same bytes.

    /joint_trajectory holds all joints, with the effort that they add; /arm_trajectory and /hand_trajectory hold the joints
    of one controller each, without effort, which a JointTrajectoryController of ROS 2 Humble refuses. /phases names each
    phase where the object is when it starts. Times are from the start of the plan.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    names, arm = plan.robot.joint_names, plan.robot.arm.num_joints
    messages = [
        (WHOLE, TRAJECTORY, 0, _trajectory(store, names, trajectory, slice(None), effort=True)),
        (ARM, TRAJECTORY, 0, _trajectory(store, names, trajectory, slice(0, arm), effort=False)),
        (HAND, TRAJECTORY, 0, _trajectory(store, names, trajectory, slice(arm, None), effort=False)),
    ]
    places = [plan.scene.T_world_object, *(phase.T_world_object for phase in plan.phases)]
    for phase, place in zip(plan.phases, places, strict=False):
        start = _nanoseconds(phase.start)
        messages.append((PHASES, MARKERS, start, _label(store, phase.name, start, place[:3, 3])))
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".bag-") as folder:
        bag = Path(folder, path.stem)
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topics: dict[str, Any] = {}
            for topic, kind, stamp, message in messages:
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, kind, typestore=store)
                writer.write(topics[topic], stamp, store.serialize_cdr(message, kind))
        next(bag.glob("*.mcap")).replace(path)


def _nanoseconds(seconds: float) -> int:
    return round(seconds * SECOND)


def _trajectory(store: Any, names: tuple[str, ...], given: JointTrajectory, part: slice, *, effort: bool) -> Any:
    types = store.types
    none = np.zeros(0)
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=given.position[sample, part],
            velocities=given.velocity[sample, part],
            accelerations=given.acceleration[sample, part],
            effort=given.effort[sample, part] if effort else none,
            time_from_start=types["builtin_interfaces/msg/Duration"](*divmod(_nanoseconds(time), SECOND)),
        )
        for sample, time in enumerate(given.time.tolist())
    ]
    return types[TRAJECTORY](header=_header(types, 0), joint_names=list(names[part]), points=points)


def _header(types: Any, stamp: int) -> Any:
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp, SECOND))
    return types["std_msgs/msg/Header"](stamp=time, frame_id=FRAME)


def _label(store: Any, text: str, stamp: int, place: np.ndarray) -> Any:
    types = store.types
    point, vector = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Vector3"]
    header, no_data = _header(types, stamp), np.zeros(0, dtype=np.uint8)
    marker = types["visualization_msgs/msg/Marker"](
        header=header,
        ns="phases",
        id=0,
        type=TEXT,
        action=0,  # add, or replace the phase before
        pose=types["geometry_msgs/msg/Pose"](
            position=point(float(place[0]), float(place[1]), float(place[2]) + ABOVE),
            orientation=types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        ),
        scale=vector(0.0, 0.0, TEXT_HEIGHT),
        color=types["std_msgs/msg/ColorRGBA"](1.0, 1.0, 1.0, 1.0),
        lifetime=types["builtin_interfaces/msg/Duration"](0, 0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=types["sensor_msgs/msg/CompressedImage"](header, "", no_data),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=types["visualization_msgs/msg/MeshFile"]("", no_data),
        mesh_use_embedded_materials=False,
    )
    return types[MARKERS](markers=[marker])
