"""xacro files: expanded as far as descriptions need it, and nothing that an expression could do besides."""

import pytest

from dexnudge.errors import HandError
from dexnudge.hands.registry import load_hand
from dexnudge.hands.xacro_expansion import checked_expression
from dexnudge.hands.xml_text import read_xml

FINGER = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="finger" params="name at *limit">
  <joint name="${name}" type="revolute"><parent link="palm"/><child link="${name}_tip"/>
    <origin xyz="${at} 0 ${sizes['palm'] / 2}"/><axis xyz="1 0 0"/><xacro:insert_block name="limit"/></joint>
  <link name="${name}_tip"><collision><geometry><box size="0.01 0.01 ${pi / 100}"/></geometry></collision></link>
</xacro:macro></robot>"""
HAND = """<robot name="made" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="side" default="right"/><xacro:property name="sizes" value="${xacro.load_yaml('sizes.yaml')}"/>
  <xacro:include filename="$(find made_hand)/urdf/finger.xacro"/>
  <link name="palm"><collision><geometry><box size="0.08 0.02 ${sizes['palm']}"/></geometry></collision></link>
  <xacro:if value="${'$(arg side)' == 'right'}">
    <xacro:finger name="index" at="0.02"><limit lower="0" upper="${pi / 2}"/></xacro:finger>
  </xacro:if>
  <xacro:finger name="thumb" at="-0.02"><limit lower="0" upper="1"/></xacro:finger>
</robot>"""


@pytest.fixture
def path(tmp_path):
    folder = tmp_path / "made_hand" / "urdf"
    folder.mkdir(parents=True)
    (folder / "finger.xacro").write_text(FINGER)
    (folder / "sizes.yaml").write_text("palm: 0.09")
    (folder / "hand.yaml").write_text("palm: palm\nfingertips: {a: index_tip, b: thumb_tip}\npalm_normal: [0, 1, 0]")
    file = folder / "hand.urdf.xacro"
    file.write_text(HAND)
    return file


def test_macros_includes_and_packages(path):
    hand = load_hand(path)
    assert hand.joint_names == ("index", "thumb")
    assert hand.upper[0] == pytest.approx(1.5707963267948966)
    assert hand.link_meshes[1].extents[2] == pytest.approx(0.0314159, abs=1e-6)
    moved = path.parent.parent.rename(path.parents[2] / "elsewhere")
    with pytest.raises(HandError, match="the package 'made_hand' is unknown: name its folder in `packages`"):
        load_hand(moved / "urdf" / path.name)
    assert load_hand(moved / "urdf" / path.name, packages={"made_hand": moved}).num_joints == 2


def test_without_the_package_the_message_says_what_to_type(path):
    with pytest.raises(HandError) as caught:
        read_xml(path, root_tag="robot", expand=lambda _: None)
    assert str(caught.value).endswith(
        "the file is xacro, not yet URDF: expected plain XML, got <arg> with a macro; install xacro, which expands it here "
        "(pip install xacro), or expand it with: xacro hand.urdf.xacro -o hand.urdf"
    )


def test_what_is_wrong_with_what_it_gives_is_said_to_be_of_xacro(path):
    (path.parent / "hand.yaml").write_text("palm: wrist\nfingertips: {a: index_tip}\npalm_normal: [0, 1, 0]")
    with pytest.raises(HandError, match="names an unknown link") as caught:
        load_hand(path)
    assert str(caught.value).endswith("; hand.urdf.xacro is xacro, look at what it gives: xacro hand.urdf.xacro")


@pytest.mark.parametrize(
    ("element", "expected"),
    [
        ('<xacro:include filename="/etc/hostname"/>', "the file '/etc/hostname' lies outside the description's folder"),
        ('<link name="$(env HOME)"/>', "environment variables are not read: HOME"),
        ('<xacro:macro name="m" params="n"><xacro:m n="1"/></xacro:macro><xacro:m n="1"/>', "recursion"),
        ('<link name="${(x for x in [1]).gi_frame}"/>', "does more than compute"),
    ],
)
def test_what_is_refused(path, element, expected):
    path.write_text(HAND.replace("</robot>", f"{element}</robot>"))
    with pytest.raises(HandError, match="xacro cannot expand it") as caught:
        load_hand(path)
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    "expression", ["2 * pi", "max(1, x)", "xacro.load_yaml('a')['b'].c", "'a' if x == 1 else 'b'", "-x[0]"]
)
def test_expressions_that_compute(expression):
    assert checked_expression(expression) == expression


@pytest.mark.parametrize(
    "expression",
    [
        "().__class__", "[x for x in y]", "(lambda: 1)()", "'{0.a}'.format(x)", "type(x)", "python.vars()", "map(str, x)",
        "x.gi_frame.f_back()", "f'{x}'", "_x", "(yield)",
    ],
)  # fmt: skip
def test_expressions_that_do_more(expression):
    with pytest.raises((ValueError, SyntaxError)):
        checked_expression(expression)
