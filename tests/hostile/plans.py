"""Hostile plans, and episodes to be converted; a plan that is read ends before it is played, or before it is served."""

from __future__ import annotations

import io
import json
import random
from functools import cache
from typing import Any

import numpy as np

from hostile.arms import ARM_YAML, arm_urdf
from hostile.case import (
    CONTROL,
    MARKUP,
    MISSING_HAND,
    Content,
    Draw,
    Hole,
    Hostile,
    Link,
    Pipe,
    as_content,
    copied,
    written,
)
from hostile.hands import WORDS, hand_files
from hostile.mutations import changed_value, damaged_bytes, damaged_json, damaged_xml, odd_values

PLAN, ROBOT, WORLD = "p/plan.json", "p/robot/robot.urdf", "p/robot/world.xml"
ARRAYS, FIGURES = "e/episode.npz", "e/episode.json"
COMMANDS = (
    ("execute", "p", "--then-grasp", "--weights", MISSING_HAND, "--out", "out"),
    ("view", "p", "--host", MISSING_HAND),
    ("execute", "p", "--films", "0", "--out", "out"),
)
RECORDS = 4  # of the episode


@cache
def data() -> dict[str, bytes]:
    """Return the files of a plan of arm and hand that wave beside a phone; nothing of it is planned."""
    import dexnudge as dn
    from dexnudge.arms.robot import Robot
    from dexnudge.trajectories.interpolation import at
    from dexnudge.trajectories.plan import JointTrajectory, Phase, Plan

    folder = written(hand_files("h") | {"a/arm.urdf": arm_urdf().encode(), "a/arm.yaml": ARM_YAML.encode()})
    base = np.eye(4)
    base[:3, 3] = (-0.5, 0.0, 0.0)
    robot = Robot(dn.load_arm(folder / "a/arm.urdf", base=base), dn.load_hand(folder / "h/hand.urdf"), np.eye(4))
    scene = dn.build_scene("table", "phone")
    start = np.concatenate([robot.arm.home, np.full(len(robot.joint_names) - len(robot.arm.home), 0.1)])
    stages = JointTrajectory(
        np.array([0.0, 2.0, 3.0, 5.0]),
        np.stack([start, start + 0.1, start + 0.1, start]),
        *(np.zeros((4, len(start))) for _ in range(3)),
    )
    time = np.linspace(0.0, 5.0, 11)
    whole = at(stages, time)
    still = np.zeros_like(whole.position)
    trajectory = JointTrajectory(time, whole.position, whole.velocity, whole.acceleration, still)
    moved = scene.T_world_object.copy()
    moved[:3, 3] += 0.05 * scene.motion
    ends = {"pre-contact": 1.0, "contact": 1.5, "squeeze": 2.0, "push": 3.0, "retreat": 5.0}
    starts = [0.0, *ends.values()]
    phases = tuple(
        Phase(
            name, begin, end, 0, moved if end > 2.0 else scene.T_world_object, {"atip": 1.5} if name == "push" else {}
        )
        for begin, (name, end) in zip(starts, ends.items(), strict=False)
    )
    Plan(robot, scene, trajectory, phases, length=0.05).save(folder / "p", pictures=False)
    return {name: content for name, content in copied(folder).items() if name.startswith("p/")}


def case(
    name: str, files: dict[str, Content], expected: Any = "either", says: str = "", *, command: int = 0
) -> Hostile:
    """Return the case of a plan's folder in which these files stand."""
    return Hostile("plan", name, {**data(), **files}, COMMANDS[command], expected, says)


def episode(**changes: Any) -> bytes:
    """Return an episode.npz with other or without some (None) arrays."""
    poses = np.tile(np.eye(4), (RECORDS, 1, 1))
    arrays = {
        "time": 0.02 * np.arange(RECORDS),
        "phase": np.full(RECORDS, "push"),
        "joint_names": np.array(["a1", "b1"]),
        "joint_angles": np.zeros((RECORDS, 2)),
        "commanded_joint_angles": np.zeros((RECORDS, 2)),
        "T_world_palm": poses,
        "T_world_object": poses,
        "mocap": np.zeros((RECORDS, 7)),
        "link_names": np.array(["palm", "atip"]),
        "link_force": np.zeros((RECORDS, 2)),
    }
    file = io.BytesIO()
    np.savez_compressed(file, **{key: value for key, value in {**arrays, **changes}.items() if value is not None})
    return file.getvalue()


def episode_case(name: str, files: dict[str, Content], expected: Any = "either", says: str = "") -> Hostile:
    """Return the case of an episode that is converted to a dataset of LeRobot."""
    return Hostile(
        "episode",
        name,
        {ARRAYS: episode(), FIGURES: b'{"success": true}', **files},
        ("convert", "e", "--to", "lerobot", "--out", "out"),
        expected,
        says,
    )


def _draw(rng: random.Random) -> Hostile:
    which, command = rng.random(), rng.choice((0, 0, 1))
    plan = json.loads(data()[PLAN])
    if which < 0.25:
        key = rng.choice([*plan])
        return case(f"another {key}", {PLAN: as_content(plan | {key: odd_values(rng)})}, command=command)
    if which < 0.5:
        what, content = damaged_json(plan, rng)
        return case(f"plan.json: {what}", {PLAN: content}, command=command)
    if which < 0.7:
        what, content = damaged_xml(data()[ROBOT], rng, WORDS)
        return case(f"robot.urdf: {what}", {ROBOT: content}, command=command)
    name = rng.choice([each for each in data() if each != PLAN])
    if name.endswith(".json") and rng.random() < 0.5:
        what, value = changed_value(json.loads(data()[name]), rng)
        content = as_content(value)
    else:
        what, content = damaged_bytes(data()[name], rng)
    return case(f"{name}: {what}", {name: content}, command=command)


def _draw_episode(rng: random.Random) -> Hostile:
    if rng.random() < 0.3:
        what, content = damaged_bytes(episode(), rng)
        return episode_case(what, {ARRAYS: content})
    if rng.random() < 0.2:
        what, content = damaged_json({"success": True, "outcome": "SUCCESS"}, rng)
        return episode_case(f"episode.json: {what}", {FIGURES: content})
    with np.load(io.BytesIO(episode())) as arrays:
        key = rng.choice(arrays.files)
        array = arrays[key]
    odd = [None, array[:1], array[:0], array[None], array.T, array.astype("S"), array.astype(str), np.float64(1),
           np.full(array.shape, np.nan), np.full(array.shape, 1e300), np.array([MARKUP, CONTROL]), np.zeros((2, 3), complex),
           np.zeros(array.shape), np.zeros((RECORDS, 0)), np.zeros((RECORDS, 3, 3)), np.array(b"a")]  # fmt: skip
    place = rng.randrange(len(odd))
    return episode_case(f"another {key}, {place}", {ARRAYS: episode(**{key: odd[place]})})


def handmade() -> list[Hostile]:
    """Return the cases made by hand."""
    plan = json.loads(data()[PLAN])

    def plans(**changes: Any) -> dict[str, Content]:
        return {PLAN: as_content(plan | changes)}

    def phase(**changes: Any) -> dict[str, Content]:
        return plans(phases=[plan["phases"][0] | changes, *plan["phases"][1:]])

    robot = data()[ROBOT].decode()
    cases: dict[str, tuple[Any, ...]] = {
        "valid": ({}, "accepted"),
        "a pipe": ({PLAN: Pipe()}, "refused"),
        "a device": ({PLAN: Link("/dev/zero")}, "refused"),
        "1 GB": ({PLAN: Hole(10**9, b"{")}, "refused"),
        "nested 100,000 deep": ({PLAN: b"[" * 100_000}, "refused"),
        "an integer of 5,000 digits": ({PLAN: b'{"format_version": ' + b"9" * 5000 + b"}"}, "refused"),
        "NaN": (plans(length=float("nan")), "refused", "length"),
        "a length of 1e300": (plans(length=1e300), "refused", "length"),
        "a key twice": ({PLAN: data()[PLAN].rstrip()[:-1] + b', "length": 1}'}, "refused", "twice"),
        "a scene outside": (plans(scene="../../etc"), "refused", "scene"),
        "a scene of a list": (plans(scene=[1]), "refused", "scene"),
        "a scene of 100,000 letters": (plans(scene="a" * 100_000), "refused"),
        "no scene": (plans(scene=None), "refused", "scene"),
        "seconds of markup": (plans(seconds={MARKUP: 1.0, CONTROL: 2.0}), "either"),
        "an arm of control characters": (plans(arm=CONTROL), "either"),
        "a joint of control characters": (plans(joint_names=[CONTROL, *plan["joint_names"][1:]]), "refused"),
        "joints of lists": (plans(joint_names=[[]]), "refused", "joint_names"),
        "10^6 samples": ({PLAN: as_content(plan | {"time": list(range(10**6))})}, "refused"),
        "a time of 1e300": (plans(time=[0.0, 1e300]), "refused", "time"),
        "no time": (plans(time=[]), "refused", "time"),
        "positions of text": (plans(position=[["x"]]), "refused", "position"),
        "velocities of 1e308": (plans(velocity=[[1e308] * len(row) for row in plan["velocity"]]), "refused"),
        "limits of 1e308": (plans(limits={name: [-1e308, 1e308, 1e308, 1e308, 1e308] for name in plan["limits"]}), "refused"),
        "an acceleration's limit of 1e-320": (plans(limits={name: [*row[:3], 1e-320, 1e-320] for name, row in plan["limits"].items()}), "refused"),
        "a base of zeros": (plans(T_world_base=[[0.0] * 4] * 4), "refused", "T_world_base"),
        "a base of 1e300": (plans(T_world_base=[[1.0, 0, 0, 1e300], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]]), "refused"),
        "a home of 10^400": (plans(home=[10**400] * len(plan["home"])), "refused", "home"),
        "actuators of text": (plans(actuators="many"), "refused", "actuators"),
        "units of text": (plans(units="many"), "refused", "units"),
        "phases twice": (plans(phases=plan["phases"] * 2), "refused", "phase"),
        "10^5 phases": (plans(phases=plan["phases"][:1] * 100_000), "refused", "phase"),
        "a phase of markup": (phase(name=MARKUP), "refused"),
        "a phase named by a list": (phase(name=[]), "refused"),
        "a force of an unknown link": (phase(link_force={CONTROL: 1.0}), "refused"),
        "a force of 1e300": (phase(link_force={"atip": 1e300}), "refused", "link_force"),
        "a configuration of True": (phase(configuration=True), "refused", "configuration"),
        "a robot that is a pipe": ({ROBOT: Pipe()}, "refused"),
        "a robot that is a device": ({ROBOT: Link("/dev/zero")}, "refused"),
        "no robot": ({ROBOT: b""}, "refused"),
        "a robot of another hand": ({ROBOT: robot.replace("atip", "ztip").encode()}, "refused"),
        "a robot with a joint twice": ({ROBOT: robot.replace('name="a2"', 'name="a1"').encode()}, "refused"),
        "a robot's mesh outside": ({ROBOT: robot.replace("meshes/", "../../../etc/").encode()}, "refused"),
        "other files": ({"p/plan.csv": Link("/dev/zero"), "p/plan.mcap": Link("nothing"), WORLD: b"", "p/README.md": b""}, "accepted"),
    }  # fmt: skip
    made = [case(f"{name}, {COMMANDS[0][0]}", *values) for name, values in cases.items()]
    made += [
        case(f"{name}, view", *cases[name], command=1)
        for name in ("valid", "a pipe", "a phase of markup", "a robot that is a pipe")
    ]
    made.append(case("valid, played", {}, "accepted", command=2))
    pieces = np.tile(np.eye(4), (RECORDS, 1, 1))
    episodes: dict[str, tuple[Any, ...]] = {
        "valid": ({}, "accepted"),
        "a pipe": ({ARRAYS: Pipe()}, "refused"),
        "a device": ({ARRAYS: Link("/dev/zero")}, "refused"),
        "figures that are a pipe": ({FIGURES: Pipe()}, "refused"),
        "times of text": ({ARRAYS: episode(time=np.full(RECORDS, "x"))}, "refused", "time"),
        "no times": ({ARRAYS: episode(time=np.zeros(0))}, "refused", "time"),
        "poses of zeros": ({ARRAYS: episode(T_world_palm=0 * pieces)}, "refused", "T_world_palm"),
        "poses mirrored": ({ARRAYS: episode(T_world_object=-pieces)}, "refused", "T_world_object"),
        "joints of another number": ({ARRAYS: episode(joint_names=np.array(["a1"]))}, "refused", "joint"),
        "joints of control characters": ({ARRAYS: episode(joint_names=np.array([CONTROL, MARKUP]))}, "either"),
        "angles of one row": ({ARRAYS: episode(joint_angles=np.zeros(RECORDS))}, "refused", "joint_angles"),
        "commands of 1e300": ({ARRAYS: episode(commanded_joint_angles=np.full((RECORDS, 2), 1e300))}, "refused", "commanded"),
        "objects": ({ARRAYS: episode(mocap=np.array([{}, []], dtype=object))}, "refused"),
        "nothing": ({ARRAYS: b""}, "refused"),
        "figures of a list": ({FIGURES: b"[]"}, "refused"),
    }  # fmt: skip
    return made + [episode_case(name, *values) for name, values in episodes.items()]


HANDMADE = handmade()
DRAWS: dict[str, Draw] = {"plan": _draw, "episode": _draw_episode}
