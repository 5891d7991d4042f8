"""Plans that say nothing, or too much: each is refused with its place, before anything is followed or played."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import pytest
import trimesh

import dexnudge as dn
from dexnudge.simulation.robot_model import load_robot_model, robot_model
from dexnudge.trajectories.plan import PHASES
from dexnudge.trajectories.plan_reader import read_plan_json

from .test_plan_folder import at


@pytest.fixture(scope="module")
def saved(crane_plan, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("saved") / "PLAN"
    crane_plan.save(folder, pictures=False)
    return folder


def each_phase(key, value):
    def change(content, _):
        for phase in content["phases"]:
            phase[key] = value

    return change


def phases_by_place(*places):
    """The phases at these places of the plan, each as long as the others."""

    def change(content, _):
        phases, end = [content["phases"][place] for place in places], content["time"][-1]
        content["phases"] = [
            phase | {"start": end * place / len(phases), "end": end * (place + 1) / len(phases)}
            for place, phase in enumerate(phases)
        ]

    return change


def no_time_to_push(content, _):
    squeeze, push = content["phases"][2:4]
    squeeze["end"] = push["start"] = push["end"]


def far_away(content, _):
    for phase in content["phases"][3:]:
        phase["T_world_object"][0][3] += 99.0


def with_lift(content, far):
    start, end = content["phases"][-1]["start"], content["time"][-1]
    last = content["phases"][-1]
    ends = [start + (end - start) * part / 3 for part in range(4)]
    lifted = json.loads(json.dumps(last["T_world_object"]))
    lifted[2][3] += far
    content["phases"][-1] = last | {"end": ends[1]}
    content["phases"] += [
        last | {"name": "regrasp", "start": ends[1], "end": ends[2]},
        last | {"name": "lift", "start": ends[2], "end": ends[3], "T_world_object": lifted},
    ]


NO_PUSH = {
    "of length 0": (at("length"), 0.0, "length is 0 m; expected more than 0, at most 2"),
    "longer than an arm": (at("length"), 99.0, "length is 99 m; expected more than 0, at most 2"),
    "of another length": (
        at("length"),
        0.06,
        r"phase 'push' has the object at .*; expected it .* by the length, 0.06 m",
    ),
    "without push": (
        phases_by_place(0, 1, 2, 4),
        None,
        "phases are 'pre-contact, contact, squeeze, retreat'; expected",
    ),
    "out of order": (phases_by_place(0, 1, 3, 2, 4), None, "contact, push, squeeze, retreat'; expected pre-contact, "),
    "repeated": (phases_by_place(0, 1, 2, 3, 3, 4), None, "squeeze, push, push, retreat'; expected pre-contact, "),
    "without retreat": (phases_by_place(0, 1, 2, 3), None, "and after them nothing or regrasp, lift"),
    "in no time": (no_time_to_push, None, "phase 'push' is from 2.5 to 2.5 s; expected it to take time"),
    "99 m away": (far_away, None, r"phase 'push' has the object at \[99.05, 0.0, .*; expected it at \[0.05, 0.0, "),
    "that stays": (at("phases", 3, "T_world_object", 0, 3), 0.0, "phase 'push' has the object at"),
    "too early": (at("phases", 1, "T_world_object", 0, 3), 0.05, "phase 'contact' has the object at"),
    "turned": (
        at("phases", 4, "T_world_object"),
        [[0, -1, 0, 0.05], [1, 0, 0, 0], [0, 0, 1, 0.03], [0, 0, 0, 1]],
        "phase 'retreat' has the object at .*, turned as in the scene",
    ),
    "lifted to the sky": (with_lift, 99.0, "phase 'lift' has the object at .*; expected it at most 0.5 m from"),
    "with a press": (
        at("phases", 3, "link_force", "atip"),
        1001.0,
        "'atip' in phase 'push' is 1001; expected 0 to 1000 N",
    ),
    "of sample 1e7": (
        each_phase("configuration", 10**7),
        None,
        "configuration is 10000000; expected an integer of 0 to",
    ),
    "of sample -1": (each_phase("configuration", -1), None, "configuration is -1; expected an integer of 0 to"),
}


@pytest.fixture
def changed(saved, tmp_path):
    """Write plan.json with one thing changed beside the robot and the scene that were saved; return the folder."""

    def written(change, value) -> Path:
        content = json.loads((saved / "plan.json").read_text())
        change(content, value)
        (tmp_path / "plan.json").write_text(json.dumps(content))
        (tmp_path / "robot").symlink_to(saved / "robot")
        shutil.copytree(saved / "scene", tmp_path / "scene")
        return tmp_path

    return written


@pytest.mark.parametrize("case", NO_PUSH)
def test_what_is_no_push_is_refused(changed, case):
    change, value, message = NO_PUSH[case]
    with pytest.raises(dn.InputError, match=message):
        dn.load_plan(changed(change, value))


def test_a_plan_may_go_on_with_a_lift(changed):
    assert [phase.name for phase in dn.load_plan(changed(with_lift, 0.1)).phases] == list(PHASES)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda plan: {"phases": tuple(phase for phase in plan.phases if phase.name != "push"), "length": 0.0},
        lambda plan: {"phases": tuple(replace(phase, name="retreat") for phase in plan.phases)},
        lambda plan: {"length": 0.0},
        lambda plan: {"length": float("nan")},
    ],
)
def test_what_is_no_push_is_neither_played_nor_saved(crane_plan, tmp_path, wrong):
    plan = replace(crane_plan, **wrong(crane_plan))
    with pytest.raises(dn.InputError, match=r"plan: (the phases are|length is) "):
        plan.execute()
    with pytest.raises(dn.InputError):
        plan.save(tmp_path / "PLAN")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("time", "message"),
    [
        ([0.0, 1e9], "time ends with 1e[+]09 s; expected at most 600 s"),
        ([0.0, 1e300], "time ends with 1e[+]300 s; expected at most 600 s"),
        ([0.0, 1e5], "time ends with 100000 s; expected at most 600 s"),
        ([0.0, 1.0, 11.5, 12.0], r"time\[2\] is 10.5 s after the sample before it; expected at most 10 s"),
        ([0.0, 1e-300, 1.0], r"time\[1\] is 1e-300 s after the sample before it; expected at least 1e-06 s"),
    ],
)
def test_long_ways_between_samples_are_refused_before_they_are_followed(changed, time, message):
    def stretch(content, _):
        content["time"] = time
        for name in ("position", "velocity", "acceleration", "effort"):
            content[name] = content[name][:1] * len(time)
        content["phases"][-1]["end"] = time[-1]

    folder = changed(stretch, None)
    start = perf_counter()
    with pytest.raises(dn.InputError, match=message):
        dn.load_plan(folder)
    assert perf_counter() - start < 1.0


def without(key):
    return lambda content, _: content.pop(key)


OTHERWISE = {
    "no motors": (without("actuators"), None, "lacks actuators"),
    "motors of nothing": (at("actuators"), None, "actuators is None; expected the 7 motors of arm and hand"),
    "a motor less": (lambda content, _: content["actuators"].pop(), None, "actuators is .*; expected the 7 motors"),
    "a motor that is none": (at("actuators", 2), 3, r"actuators\[2\]: name is 3; expected bend, of the motor 'bend'"),
    "motor of a joint": (
        at("actuators", 0, "joints"),
        {"elbow": 1.0},
        r"actuators\[0\]: joints is {'elbow': 1.0}; exp",
    ),
    "pulls twice": (at("actuators", 6, "joints", "b1"), 2.0, r"actuators\[6\]: joints is .*; expected {'b1': 1.0"),
    "stiffer": (
        at("actuators", 0, "kp"),
        5.1e4,
        r"actuators\[0\]: kp is 51000.0; expected .*, of the motor 'crane_a1'",
    ),
    "kv of NaN": (at("actuators", 0, "kv"), float("nan"), r"actuators\[0\]: kv is nan; expected"),
    "kp of text": (at("actuators", 0, "kp"), "5000", r"actuators\[0\]: kp is '5000'; expected"),
    "no units of a slide": (without("units"), None, r"units is None; expected \['rad', 'm', 'rad'"),
    "degrees": (at("units"), ["deg"] * 9, r"units is \['deg', .*; expected \['rad', 'm', 'rad'"),
    "home beyond": (at("home", 1), 0.4, "home of 'lift' is 0.4; expected it within its limits -0.2 to 0.3"),
}


@pytest.mark.parametrize("case", OTHERWISE)
def test_a_plan_of_another_robot_is_refused(changed, case):
    change, value, message = OTHERWISE[case]
    with pytest.raises(dn.InputError, match=message):
        dn.load_plan(changed(change, value))


def test_a_key_that_stands_twice_is_refused(saved, changed):
    folder = changed(lambda *_: None, None)
    text = (folder / "plan.json").read_text()
    (folder / "plan.json").write_text(text.replace('"length"', '"arm": "other", "length"', 1))
    with pytest.raises(dn.InputError, match="the key 'arm' stands twice in an object; expected it once"):
        dn.load_plan(folder)
    (folder / "plan.json").write_text(text)
    file = folder / "scene" / "scene.json"
    file.write_text(file.read_text().replace('"motion"', '"motion": [0, 0, 1], "motion"', 1))
    with pytest.raises(dn.InputError, match=r"scene.json: .*the key 'motion' stands twice in an object"):
        dn.load_plan(folder)


def test_a_robot_whose_files_were_changed_is_refused(saved, tmp_path):
    folder = Path(shutil.copytree(saved, tmp_path / "PLAN"))
    urdf = folder / "robot" / "robot.urdf"
    text = urdf.read_text()
    urdf.write_text(text.replace('effort="50.0"', 'effort="1000000000.0"'))
    assert urdf.read_text() != text
    with pytest.raises(
        dn.InputError, match=r"actuators\[0\]: kp is .*; it follows from the robot's joints and efforts"
    ):
        dn.load_plan(folder)
    urdf.write_text(text)
    (mesh,) = (folder / "robot" / "meshes").glob("*column.obj")
    trimesh.load_mesh(mesh).apply_scale(1000.0).export(mesh)
    with pytest.raises(dn.InputError, match=r"link 'column' is 60 m long: expected at most 20 m; in millimetres\?"):
        dn.load_plan(folder)


@pytest.mark.parametrize(
    "part",
    [
        '<include file="other.xml"/>',
        '<asset><mesh name="x" file="/tmp/x.obj"/></asset>',
        '<asset><hfield name="x" file="x.png"/></asset>',
        '<asset><texture name="x" type="cube" fileup="x.png"/></asset>',
        '<asset><model name="x" file="other.xml"/></asset>',
    ],
)
def test_a_model_that_names_files_is_refused(crane_plan, part):
    xml = robot_model(crane_plan.robot, crane_plan.scene).simulation.xml
    with pytest.raises(dn.InputError, match="> opens a file; expected all of it in the text"):
        load_robot_model(xml.replace("</mujoco>", part + "</mujoco>"), crane_plan.robot)
    with pytest.raises(dn.InputError, match="document types and entities are not read"):
        load_robot_model('<!DOCTYPE a [<!ENTITY b "c">]>' + xml, crane_plan.robot)


def test_phases_are_counted_before_they_are_made(saved, tmp_path, monkeypatch):
    monkeypatch.setattr("dexnudge.trajectories.plan_reader.from_fields", None)
    content = json.loads((saved / "plan.json").read_text())
    content["phases"] *= 100
    (tmp_path / "plan.json").write_text(json.dumps(content))
    with pytest.raises(dn.InputError) as caught:
        read_plan_json(tmp_path / "plan.json")
    counted = f"phases has {len(content['phases'])} entries; expected at most {len(PHASES)}"
    assert str(caught.value) == f"{tmp_path / 'plan.json'}: {counted}; plan again, or take the file as it was written"
