"""Descriptions and YAMLs that cannot be used: each ends in one message that says what, where, and how to mend it."""

import pytest

import dexnudge as dn

from .made_up import LIMITS, joint, limit, link, six_axis_mjcf, six_axis_urdf

SOLID_END = link("jaw") + joint("grip", "l6", "jaw", ("0 0 0.1", "0 0 0"), '<axis xyz="1 0 0"/>' + limit())


@pytest.mark.parametrize(
    ("facts", "message"),
    [
        (
            {"flang": "tool0"},
            r"six.yaml has the unknown field 'flang' \(did you mean 'flange'\?\); expected flange, base, home",
        ),
        (
            {"flange": "tool"},
            r"names an unknown link: key 'flange': expected one of .*'tool' \(did you mean 'tool0'\?\)",
        ),
        ({"flange": 3}, "flange is 3; expected a name"),
        ({"base": "l9"}, "unknown link: key 'base'"),
        ({"flange": "l3"}, "at least 4 joints between base and flange, found 3 between 'l0' and 'l3'"),
        ({"home": [0.1] * 5}, "key 'home': expected 6 numbers, of j1, j2, j3, j4, j5, j6"),
        ({"home": {"j1": 0.1}}, "key 'home': expected an angle of every joint, missing j2, j3, j4, j5, j6"),
        ({"home": {"elbow": 0.1}}, "key 'home': expected joints of the arm, j1, j2, j3, j4, j5, j6, got 'elbow'"),
        ({"home": [0, 0, 0, 0, 0, 3.0]}, "joint 'j6' within its limits, -2.5 to 2.8, got 3"),
        ({"home": [0, 0, 0, 0, 0, float("nan")]}, "key 'home': expected a finite number for 'j6', got nan"),
        ({"home": "up"}, "key 'home': expected a finite number for 'j1', got 'up'"),
        ({"limits": [1]}, r"limits is \[1\]; expected lines such as"),
        ({"limits": {"accel": 1}}, r"limits is {'accel': 1}; expected lines such as 'jerk: 100', of lower, upper"),
        ({"limits": {**LIMITS, "jerk": -1}}, r"joint 'j1': expected a limit of jerk above 0 rad/s\^3, got -1"),
        ({"limits": {**LIMITS, "acceleration": 0}}, r"joint 'j1': expected a limit of acceleration above 0 rad/s\^2"),
        ({"limits": {**LIMITS, "jerk": float("inf")}}, "key 'jerk': expected a finite number for 'j1', got inf"),
        ({"limits": {**LIMITS, "jerk": True}}, "key 'jerk': expected a finite number for 'j1', got True"),
        ({"limits": {**LIMITS, "jerk": {"j7": 3}}}, "key 'jerk': expected joints of the arm, .*'j7"),
        (
            {"limits": {**LIMITS, "velocity": 180}},
            "limit of velocity in rad/s, at most 35, got 180; in degrees",
        ),
        (
            {"limits": {**LIMITS, "lower": 1, "upper": -1}},
            "'j1': expected a lower limit below the upper one, got 1 and -1",
        ),
        ({"geometry": "both"}, "geometry is 'both'; expected 'collision' or 'visual'"),
        ({"geometry": "visual"}, "expected visual geometry, found none"),
        ("- 1\n", "expected 'key: value' lines, got list; write flange, base, home"),
        ("flange: *x", "YAML aliases are not read"),
        ("flange: [", "not a YAML file"),
    ],
)
def test_a_yaml_that_cannot_be_used_is_refused(described, facts, message):
    facts = {"limits": LIMITS, **facts} if isinstance(facts, dict) else facts
    with pytest.raises(dn.ArmError, match=message):
        dn.load_arm(described(six_axis_urdf(), facts))


def changed(old: str, new: str, count: int = 1):
    return six_axis_urdf().replace(old, new, count)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            six_axis_urdf(end="l7", extra=SOLID_END),
            r"flange named: .* one of jaw, l4, l5, l6, l7; write 'flange: LINK'",
        ),
        (
            changed('velocity="3.0"', 'velocity="nan"'),
            "joint 'j1': expected a limit of velocity above 0 rad/s, got nan",
        ),
        (changed('effort="40.0"', 'effort="-4"'), "joint 'j1': expected a limit of effort of at least 0, got -4"),
        (changed('effort="40.0"', 'effort="strong"'), "joint 'j1': expected a limit of effort above 0 N m, got nan"),
        (
            changed('lower="-2.5" upper="2.8"', 'lower="-170" upper="170"'),
            r"'j1': expected limits in radians, .* write -2.9671",
        ),
        (
            changed('lower="-2.5" upper="2.8"', 'lower="0" upper="0"'),
            "'j1': expected a lower limit below the upper",
        ),
        (
            changed('name="j3" type="revolute"', 'name="j3" type="planar"'),
            "'j3' between base and flange moves as a planar",
        ),
        (changed('link="l3"', 'link="l33"'), "unknown"),
        (
            changed('xyz="0.3 0.01 0"', 'xyz="300 10 0"'),
            "'j3' lies 300 m from the frame of 'l2': expected at most 20 m",
        ),
        (changed('size="0.06 0.05 0.12"', 'size="60 50 120"'), "link 'l0' is 120 m long: .* in millimetres"),
        ("<robot name='six'><link name='l0'/></robot>", "expected collision or visual geometry, found none"),
        (
            "<robot name='six'>" + link("l0") + "</robot>",
            "expected an arm of at least 4 joints one after another, found 0",
        ),
        ("<robot", "not well-formed XML"),
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><robot/>", "document types and entities are not read"),
    ],
)
def test_a_description_that_cannot_be_used_is_refused(described, text, message):
    with pytest.raises(dn.ArmError, match=message):
        dn.load_arm(described(text, {"limits": LIMITS}))


def test_a_follower_of_a_joint_that_is_cut_off_is_refused(described):
    extra = link("pedal") + joint("pedal_turn", "l0", "pedal", ("0 1 0", "0 0 0"), '<axis xyz="1 0 0"/>' + limit())
    text = six_axis_urdf(extra=extra).replace("</joint>", '<mimic joint="pedal_turn"/></joint>', 1)
    with pytest.raises(dn.ArmError, match="joint 'j1' between base and flange follows 'pedal_turn'"):
        dn.load_arm(described(text, {"limits": LIMITS, "flange": "tool0"}))


def test_an_mjcf_says_which_limits_it_lacks(described):
    text = six_axis_mjcf().replace('forcerange="-30 20"', "", 1)
    with pytest.raises(
        dn.ArmError, match=r"velocity of all joints; acceleration of .*; jerk of all joints; effort of j1"
    ):
        dn.load_arm(described(text, name="six.xml"))


def test_what_is_no_arm_is_refused(tmp_path):
    with pytest.raises(dn.UnknownNameError, match=r"unknown arm 'pandas' \(did you mean 'panda'\?\): expected .* ur5e"):
        dn.load_arm("pandas")
    with pytest.raises(dn.ArmError, match="the description is missing: expected a file at"):
        dn.load_arm(tmp_path / "none.urdf")
    (tmp_path / "arm.txt").write_text("")
    with pytest.raises(dn.ArmError, match=r"ends in .urdf, .xml or .xacro, got '.txt'"):
        dn.load_arm(tmp_path / "arm.txt")
