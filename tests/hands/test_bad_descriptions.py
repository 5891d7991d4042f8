"""Every description that cannot be used is refused with one message: what, expected, got, how to mend it."""

import mujoco
import numpy as np
import pytest
import torch

from dexnudge.errors import HandError, UnknownNameError
from dexnudge.hands.export import export_hand
from dexnudge.hands.registry import check_packages, load_hand
from dexnudge.hands.xml_text import MAX_DESCRIPTION_BYTES

SMALL_YAML = "palm: palm\nfingertips: {F: pad, T: thumbtip}\npalm_normal: [0, -2, 0]\nbase_link: forearm\n"
HELD_IN = ", or name the folder that holds them in `packages`"
NAME_IT = ", or name the folder of 'small' in `packages`"
LINKS = "['forearm', 'thumb', 'palm', 'finger', 'tip', 'thumbtip', 'pad']"


def message(path) -> str:
    with pytest.raises(HandError) as caught:
        load_hand(path)
    return str(caught.value).replace(str(path.parent), "DIR")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            '<robot name="small">',
            '<!DOCTYPE robot [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]><robot name="&b;">',
            (
                "DIR/small.urdf: document types and entities are not read: expected plain XML, got '<!DOCTYPE'; "
                "remove it (for xacro: expand the file first)"
            ),
        ),
        (
            '<link name="thumb"/>',
            '<link name="thumb"/><joint name="loop" type="fixed"><parent link="thumbtip"/><child link="pad"/></joint>',
            (
                "kinematic loop: expected one joint above each link, got 'loop' and 'mount' above link 'pad'; "
                "cut the loop (closed chains are not supported)"
            ),
        ),
        (
            '<parent link="forearm"/>',
            '<parent link="tip"/>',
            "kinematic loop: expected a tree, got link 'palm' below itself; cut the loop (closed chains are not supported)",
        ),
        (
            '<link name="thumb"/>',
            '<link name="thumb"/><link name="loose"/>',
            "expected one root link, got ['forearm', 'loose']; connect them with joints or remove the loose ones",
        ),
        (
            '<parent link="thumb"/>',
            '<parent link="thump"/>',
            f"joint 'spin' names an unknown parent link 'thump'; expected one of {LINKS}; mend the name or add the link",
        ),
        (
            ' lower="-0.5" upper="0.7"',
            ' upper="0.7"',
            "DIR/small.urdf: joint 'wrist': expected <limit lower=... upper=...> in radians, missing ['lower']; add them",
        ),
        (
            '<limit lower="-0.5" upper="0.7"/>',
            "",
            (
                "DIR/small.urdf: joint 'wrist': expected <limit lower=... upper=...> in radians, "
                "missing ['lower', 'upper']; add them"
            ),
        ),
        (
            'lower="-0.5"',
            'lower="nan"',
            "DIR/small.urdf: joint 'wrist': expected 1 finite number(s) in 'lower', got 'nan'; mend it",
        ),
        (
            'lower="-0.5"',
            'lower="0.9"',
            "DIR/small.urdf: joint 'wrist': expected lower limit <= upper limit, got 0.9 > 0.7; swap or mend them",
        ),
        (
            'xyz="0 0 0.05"',
            'xyz="0 inf 0.05"',
            "DIR/small.urdf: joint 'far': expected 3 finite number(s) in 'xyz', got '0 inf 0.05'; mend it",
        ),
        (
            'xyz="0 0 0.05"',
            'xyz="0 0.05"',
            "DIR/small.urdf: joint 'far': expected 3 finite number(s) in 'xyz', got '0 0.05'; mend it",
        ),
        (
            'xyz="0 3 4"',
            'xyz="0 0 0"',
            "DIR/small.urdf: joint 'wrist': expected an axis of non-zero length, got [0.0, 0.0, 0.0]; mend <axis>",
        ),
        (
            'type="continuous"',
            'type="prismatic"',
            ("joint 'spin' slides without limits: expected a least and a greatest value [m], found none; add them"),
        ),
        (
            'type="continuous">',
            'type="prismatic"><limit lower="0" upper="40"/>',
            (
                "joint 'spin': expected limits in metres, at most 0.5 from zero, got 0 to 40; in millimetres? write "
                "0 to 0.04"
            ),
        ),
        (
            'type="continuous"',
            'type="planar"',
            (
                "joint 'spin': expected type revolute, continuous, prismatic, fixed, got 'planar'; replace the joint or "
                "fix it"
            ),
        ),
        (
            '<mimic joint="near"',
            '<mimic joint="nearby"',
            (
                "joint 'middle' mimics 'nearby' (did you mean 'near'?): expected one of ['wrist', 'near', 'spin'], or a "
                "joint that mimics one; mend the <mimic> element"
            ),
        ),
        (
            '<mimic joint="near"',
            '<mimic joint="far"',
            (
                "joint 'far' mimics 'middle': expected one of ['wrist', 'near', 'spin'], or a joint that mimics one; "
                "mend the <mimic> element"
            ),
        ),
        (
            '<link name="thumb"/>',
            '<link name="thumb"/><link name="thumb"/>',
            "DIR/small.urdf: expected each link name once, got ['thumb'] more than once; rename them",
        ),
        (
            '<sphere radius="0.009"/>',
            '<sphere radius="-1"/>',
            "DIR/small.urdf: link 'tip': <sphere>: expected radius above zero, got {'radius': '-1'}; mend it",
        ),
        (
            '<sphere radius="0.009"/>',
            '<plane normal="0 0 1"/>',
            (
                "DIR/small.urdf: link 'tip': expected mesh, box, cylinder, sphere or capsule, got <plane>; add one, replace "
                "it by a mesh, or remove the element"
            ),
        ),
        (
            '<parent link="thumb"/>',
            "",
            "DIR/small.urdf: joint 'spin': expected <parent link=...>, found none; add it",
        ),
        (
            "package://small/wedge.stl",
            "wedge.blend",
            (
                "mesh 'wedge.blend' is missing: expected a file below DIR, found none; "
                "copy it there or mend its name in the description"
            ),
        ),
        *[
            (
                "package://small/wedge.stl",
                outside,
                (
                    f"mesh '{outside}' lies outside the description's folder: expected a file below DIR; "
                    "copy the meshes beside the description and name them relative to it"
                    f"{NAME_IT if outside.startswith('package') else '' if '://' in outside else HELD_IN}"
                ),
            )
            for outside in (
                "../wedge.stl",
                "/etc/hostname",
                "package://small/../../wedge.stl",
                "file:///etc/hostname",
                "link.stl",
            )
        ],
        (
            "package://small/wedge.stl",
            "hand.yaml",
            "DIR/hand.yaml: expected a mesh of .stl, .obj, .dae, .ply, .glb, got '.yaml'; convert it",
        ),
        (
            "package://small/wedge.stl",
            "empty.obj",
            (
                "DIR/empty.obj: not readable as obj: expected a triangle mesh, got 'empty.obj: cannot be read as obj "
                "(no triangles in it; a point cloud must be meshed first); the file is truncated, damaged or not a mesh; "
                "export it again'; mend or re-export the mesh"
            ),
        ),
    ],
)
def test_bad_urdf(write_hand, old, new, expected):
    path = write_hand()
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    (path.parent / "link.stl").symlink_to("/etc/hostname")
    (path.parent / "empty.obj").write_text("# nothing\n")
    assert message(path) == expected


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            'upper="1.2"',
            'upper="90"',
            (
                "joint 'near': expected limits in radians, got 0 to 90, that is up to 5157 degrees; "
                "in degrees? write 0.0000 to 1.5708"
            ),
        ),
        (
            'xyz="0 0 0.05"',
            'xyz="0 0 50"',
            (
                "joint 'far' lies 50 m from the frame of 'finger': expected at most 2 m; in millimetres? "
                "give its origin in metres"
            ),
        ),
        (
            'scale="0.001 0.002 0.001"',
            "",
            (
                "link 'thumbtip' is 20 m long: expected at most 2 m; in millimetres? "
                'give its mesh scale="0.001 0.001 0.001", or a basic shape its size in metres'
            ),
        ),
        (
            '<box size="0.04 0.05 0.06"/>',
            '<box size="100 100 100"/>',
            (
                "link 'forearm' is 109 m long: expected at most 2 m; in millimetres? "
                'give its mesh scale="0.001 0.001 0.001", or a basic shape its size in metres'
            ),
        ),
        (
            '<box size="0.04 0.05 0.06"/>',
            '<sphere radius="0.8"/>',
            (
                "link 'forearm' has a surface of 8 m^2: expected at most 2 m^2; "
                "give it a simpler shape, or its size in metres"
            ),
        ),
        (
            "package://small/wedge.stl",
            "sheet.obj",
            (
                "the geometry of link 'thumbtip' is flat: expected a body with a thickness, which physics needs; "
                "give it one, or replace it by a thin box"
            ),
        ),
        (
            '<sphere radius="0.009"/>',
            '<sphere radius="${size}"/>',
            (
                "DIR/small.urdf: xacro cannot expand it: expected properties, macros and files below the description's "
                "folder, got 'name 'size' is not defined'; mend it, or expand it yourself with: xacro small.urdf -o "
                "hand.urdf"
            ),
        ),
    ],
)
def test_what_was_meant_otherwise_is_asked(write_hand, old, new, expected):
    path = write_hand()
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    (path.parent / "sheet.obj").write_text("v 0 0 0\nv 20 0 0\nv 0 10 0\nf 1 2 3\n")
    assert message(path) == expected


def test_a_digit_without_geometry(write_hand):
    path = write_hand(config="palm: palm\nfingertips: {T: thumb}\npalm_normal: [0, 1, 0]")
    text = path.read_text()
    start, end = text.index('<link name="palm">'), text.index("</link>", text.index('<link name="palm">'))
    path.write_text(text[:start] + '<link name="palm">' + text[end:])
    assert message(path) == (
        "digit 'T' has no geometry: expected it on 'thumb' or a link between that and the palm, found none; "
        "add geometry or mend 'fingertips' in the hand's YAML"
    )


def test_more_links_than_any_hand_has(write_hand):
    joint = '<joint name="j{0}" type="fixed"><parent link="l{1}"/><child link="l{0}"/></joint>'
    links = "".join(f'<link name="l{k}"/>' for k in range(5001))
    joints = "".join(joint.format(k, k - 1) for k in range(5000, 0, -1))
    assert message(write_hand(f"<robot>{links}{joints}</robot>")) == (
        "DIR/small.urdf: expected at most 1,000 <link> elements, found 5,001; mend or re-export the URDF"
    )


def test_missing_file(tmp_path):
    assert message(tmp_path / "no.urdf") == (
        "the description is missing: expected a file at DIR/no.urdf, found none; mend the path"
    )


def test_truncated_file(write_hand):
    path = write_hand()
    path.write_text(path.read_text()[:500])
    text = message(path)
    assert text.startswith(
        "DIR/small.urdf: not well-formed XML: expected a complete <robot> element, got an error at '"
    )
    assert text.endswith("'; mend or re-export the file")


def test_entities_hidden_by_an_encoding(write_hand):
    path = write_hand()
    path.write_bytes('<!DOCTYPE robot [<!ENTITY a "a">]><robot/>'.encode("utf-16"))
    assert message(path) == (
        "DIR/small.urdf: not a text file: expected XML in UTF-8, got invalid start byte; save it as UTF-8"
    )


@pytest.mark.parametrize("encoding", ["ISO-8859-1", "windows-1252"])
def test_one_byte_a_letter_is_read_where_it_is_declared(write_hand, encoding):
    path = write_hand()
    plain = path.read_text()
    plain = plain[plain.index("<robot") :].replace("</robot>", "<!-- Größe: Ø 8 mm --></robot>")
    path.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>\n{plain}'.encode(encoding))
    assert load_hand(path).joint_names
    hidden = f'<?xml version="1.0" encoding="{encoding}"?><!DOCTYPE robot [<!ENTITY a "é">]><robot/>'
    path.write_bytes(hidden.encode(encoding))
    assert "document types and entities are not read" in message(path)
    path.write_bytes(plain.encode(encoding))
    assert message(path).endswith("save it as UTF-8")


def test_declared_encoding_is_not_obeyed(write_hand):
    path = write_hand()
    path.write_text('<?xml version="1.0" encoding="utf-7"?>\n+ADwAIQ-DOCTYPE robot [+ADwAIQ-ENTITY a "a">]>\n<robot/>')
    assert message(path).startswith("DIR/small.urdf: not well-formed XML")


def test_huge_file(write_hand):
    path = write_hand()
    path.write_bytes(b" " * (MAX_DESCRIPTION_BYTES + 1))
    assert message(path) == (
        "DIR/small.urdf: the file is too large: expected at most 10000000 bytes of XML, got 10000001; "
        "keep meshes in files of their own"
    )


def test_not_a_robot(write_hand):
    path = write_hand("<sdf/>")
    assert (
        message(path) == "DIR/small.urdf: wrong kind of file: expected a root element <robot>, got <sdf>; mend the path"
    )


def test_no_links(write_hand):
    assert message(write_hand("<robot/>")) == (
        "DIR/small.urdf: expected <link> elements, found none; mend or re-export the URDF"
    )


def test_no_joints(write_hand):
    ball = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
    urdf = f'<robot name="stiff"><link name="palm">{ball}</link></robot>'
    config = "palm: palm\nfingertips: {A: palm}\npalm_normal: [0, 0, 1]"
    assert message(write_hand(urdf, config)) == (
        "hand 'stiff' cannot move: expected at least one revolute or prismatic joint, found none; mend the description"
    )


def test_closed_ring_without_a_root(write_hand):
    ring = '<joint name="{0}{1}" type="fixed"><parent link="{0}"/><child link="{1}"/></joint>'
    urdf = (
        f'<robot><link name="a"/><link name="b"/><link name="c"/>{ring.format("b", "c")}{ring.format("c", "b")}</robot>'
    )
    assert message(write_hand(urdf)) == (
        "kinematic loop: expected a tree, got link 'b' below itself; cut the loop (closed chains are not supported)"
    )


def test_no_collision_geometry(write_hand):
    path = write_hand()
    path.write_text(path.read_text().replace("collision>", "inertial>"))
    assert message(path) == (
        "hand 'small' has no collision geometry: expected it on at least one link, found none; "
        "add <collision> elements or set 'geometry' in the hand's YAML to the other kind"
    )


def test_truncated_mesh(write_hand):
    path = write_hand()
    mesh = path.parent / "wedge.stl"
    mesh.write_bytes(mesh.read_bytes()[:100])
    assert message(path) == (
        "DIR/wedge.stl: not readable as stl: expected a triangle mesh, got 'wedge.stl: cannot be read as stl "
        "(64 faces announced, room for 0); the file is truncated, damaged or not a mesh; export it again'; "
        "mend or re-export the mesh"
    )


def test_mesh_of_another_kind(write_hand):
    path = write_hand()
    (path.parent / "wedge.ply").write_text("solid")
    path.write_text(path.read_text().replace("wedge.stl", "wedge.ply"))
    text = message(path)
    assert text.startswith("DIR/wedge.ply: not readable as ply: expected a triangle mesh, got '")
    assert text.endswith("'; mend or re-export the mesh")


def test_entities_in_a_mesh(write_hand):
    path = write_hand()
    (path.parent / "wedge.dae").write_text('<!DOCTYPE COLLADA [<!ENTITY a "b">]><COLLADA/>')
    path.write_text(path.read_text().replace("wedge.stl", "wedge.dae"))
    assert message(path).startswith("DIR/wedge.dae: document types and entities are not read")


def test_without_yaml_the_message_says_what_to_write(write_hand):
    assert message(write_hand(config=None)) == (
        "DIR/small.urdf has no YAML beside it: expected small.yaml or hand.yaml with the palm, the fingertips and the "
        "direction in which the palm faces; let `prepare` find them, or check these lines, write the direction in the "
        "palm's frame in place of x, y and z, and save them there:\n"
        "palm: palm\nfingertips: {thumb: thumbtip, pad: pad}\npalm_normal: [x, y, z]"
    )


def test_the_proposed_yaml_names_digits_and_no_empty_mount_and_waits_for_the_palms_direction(write_hand):
    path = write_hand(config=None)
    joint = '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>{4}</joint>'
    limits = '<axis xyz="1 0 0"/><limit lower="0" upper="1" effort="1" velocity="1"/>'
    links = ("mount", "base", "index_1", "index_2", "thumb_1", "thumb_2")
    parts = [f'<link name="{name}"/>' for name in links]
    parts.append(joint.format("screws", "fixed", "mount", "base", ""))
    for digit in ("index", "thumb"):
        parts.append(joint.format(f"{digit}_j1", "revolute", "base", f"{digit}_1", limits))
        parts.append(joint.format(f"{digit}_j2", "revolute", f"{digit}_1", f"{digit}_2", limits))
    path.write_text(f'<robot name="pair">{"".join(parts)}</robot>')
    lines = message(path).splitlines()[1:]
    assert lines == ["palm: base", "fingertips: {index: index_2, thumb: thumb_2}", "palm_normal: [x, y, z]"]
    path.with_suffix(".yaml").write_text("\n".join(lines))
    assert "palm_normal is ['x', 'y', 'z']; expected three numbers [x, y, z]" in message(path)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "palm: palm",
            "palm: hand",
            f"the hand's YAML names an unknown link: key 'palm': expected one of {LINKS}, got 'hand'; mend it",
        ),
        (
            "[spin, near]",
            "[spin, middle]",
            (
                "the hand's YAML couples an unknown joint: key 'couplings': expected some of ['wrist', 'near', 'spin'], "
                "got 'middle'; mend it"
            ),
        ),
        (
            "palm: palm\n",
            "",
            "DIR/hand.yaml lacks palm; expected palm, fingertips, palm_normal; mend it",
        ),
        (
            "palm: palm",
            "palm: palm\npalms: 2",
            (
                "DIR/hand.yaml has the unknown field 'palms' (did you mean 'palm'?); expected palm, fingertips, "
                "palm_normal, couplings, base_link, geometry, name; mend it"
            ),
        ),
        (
            "[0, -2, 0]",
            "[0, 0, 0]",
            "DIR/hand.yaml: palm_normal is [0, 0, 0]; expected three numbers [x, y, z], not all zero; mend it",
        ),
        (
            "[0, -2, 0]",
            "[0, .nan, 0]",
            "DIR/hand.yaml: palm_normal is [0, nan, 0]; expected three numbers [x, y, z], not all zero; mend it",
        ),
        (
            "{F: pad, T: thumbtip}",
            "[pad]",
            (
                "DIR/hand.yaml: fingertips is ['pad']; expected at least one line 'digit: link', names that look like "
                "numbers in quotes; mend it"
            ),
        ),
        (
            "[[spin, near]]",
            "[[spin]]",
            "DIR/hand.yaml: couplings is [['spin']]; expected pairs of joints [follower, leader]; mend it",
        ),
        (
            "base_link: forearm",
            "geometry: convex",
            "DIR/hand.yaml: geometry is 'convex'; expected 'collision' or 'visual'; mend it",
        ),
    ],
)
def test_bad_yaml(write_hand, old, new, expected):
    path = write_hand()
    config = path.parent / "hand.yaml"
    assert old in config.read_text()
    config.write_text(config.read_text().replace(old, new, 1))
    assert message(path) == expected


def test_yaml_aliases_are_not_expanded(write_hand):
    lines = "a: &a [x, x]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 10))
    text = message(write_hand(config=lines.replace("*a0", "*a")))
    assert text == "DIR/hand.yaml: YAML aliases are not read: expected plain values, got '*'; write them out"


def test_a_wrong_value_is_not_printed_whole(write_hand):
    assert len(message(write_hand(config=f"palm: {list(range(9000))}\nfingertips: 0\npalm_normal: 0"))) < 400


def test_links_with_numbers_for_names_are_printed_so_that_they_can_be_pasted(write_hand):
    path = write_hand(config=None)
    for number, name in enumerate(("forearm", "thumbtip", "thumb", "palm", "finger", "pad", "tip")):
        path.write_text(path.read_text().replace(f'"{name}"', f'"{number}"'))
    lines = message(path).partition("save them there:\n")[2]
    path.with_suffix(".yaml").write_text(lines.replace("[x, y, z]", "[0, 0, 1]"))
    assert load_hand(path).link_names[0] == "3"


def test_yaml_that_is_none(write_hand):
    assert message(write_hand(config="palm: [")).startswith(
        "DIR/hand.yaml: not a YAML file: expected 'key: value' lines, got '"
    )
    assert message(write_hand(config="palm")) == (
        "DIR/hand.yaml: expected 'key: value' lines, got str; write palm, fingertips, palm_normal"
    )


def test_coupling_that_cannot_hold(write_hand):
    path = write_hand()
    path.write_text(path.read_text().replace('lower="0" upper="1.2"', 'lower="-5" upper="-4"'))
    assert message(path) == (
        "coupling spin <= near cannot hold: expected spin's lower limit at most near's upper, "
        "got -3.141592653589793 and -4.0 rad; swap the pair or mend the limits"
    )


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(UnknownNameError) as caught:
        load_hand("robonaut")
    assert str(caught.value) == (
        "unknown hand 'robonaut': expected one of allegro, dex3, leap, panda_gripper, shadow_full, shadow_lite, "
        "or the path of a .urdf or .xml file; mend the name"
    )


def test_file_of_another_kind(tmp_path):
    file = tmp_path / "hand.sdf"
    file.write_text("")
    with pytest.raises(HandError, match=r"expected a description that ends in \.urdf or \.xml, got '\.sdf'"):
        load_hand(file)


def test_a_leader_that_lacks_its_prefix_is_named(write_hand):
    path = write_hand()
    path.write_text(path.read_text().replace('name="near"', 'name="Right_near"'))
    (path.parent / "hand.yaml").write_text("palm: palm\nfingertips: {F: pad}\npalm_normal: [0, -2, 0]")
    assert message(path) == (
        "joint 'middle' mimics 'near' (did you mean 'Right_near'?): expected one of ['wrist', 'Right_near', 'spin'], or a "
        "joint that mimics one; mend the <mimic> element"
    )


@pytest.mark.parametrize(
    ("inertial", "note"),
    [
        (
            '<mass value="-1"/>',
            "mass or moments of inertia of tip are not above zero: each link has that of its geometry",
        ),
        ('<mass value="1"/><inertia ixx="0" iyy="0" izz="0"/>', "mass or moments of inertia of tip are not above zero"),
    ],
)
def test_masses_that_cannot_be_are_noted(write_hand, inertial, note):
    path = write_hand()
    path.write_text(path.read_text().replace('<link name="tip">', f'<link name="tip"><inertial>{inertial}</inertial>'))
    assert load_hand(path).notes[0].startswith(note)
    path.write_text(path.read_text().replace('<mass value="', '<mass value="nan'))
    assert "link 'tip': expected 1 finite number(s) in 'value', got 'nan" in message(path)


def test_a_base_that_only_has_a_name_is_empty(write_hand):
    path = write_hand(config=SMALL_YAML.replace("base_link: forearm\n", ""))
    text = path.read_text()
    start, end = text.index('<link name="forearm">'), text.index("</link>") + len("</link>")
    path.write_text(text[:start] + text[end:])
    assert load_hand(path).notes == (
        "link 'forearm', from which the others hang, does not exist: an empty one stands for it",
    )


def test_an_element_without_a_shape_is_left_out_where_others_are(write_hand):
    path = write_hand()
    path.write_text(path.read_text().replace('<link name="tip">', '<link name="tip"><collision/>'))
    assert (
        load_hand(path).notes[0].startswith("link 'tip': expected <collision> with one shape in <geometry>, found none")
    )


def test_a_given_package_holds_meshes_and_nothing_else_is_opened(write_hand, tmp_path):
    path = write_hand()
    other = tmp_path / "elsewhere" / "meshes"
    other.mkdir(parents=True)
    (path.parent / "wedge.stl").rename(other / "wedge.stl")
    text = path.read_text().replace("package://small/wedge.stl", "package://brand/meshes/wedge.stl")
    home = tmp_path / "home"
    home.mkdir()
    (path.parent / "hand.yaml").rename(home / "hand.yaml")
    path = home / "small.urdf"
    path.write_text(text)
    assert "or name the folder of 'brand' in `packages`" in message(path)
    assert load_hand(path, packages={"brand": other.parent}).num_joints == 3
    path.write_text(text.replace("meshes/wedge.stl", "../../../etc/hostname"))
    with pytest.raises(HandError, match="lies outside the description's folder"):
        load_hand(path, packages={"brand": other.parent})


def test_a_mesh_beside_the_folder_is_read_where_the_message_says_how(write_hand, tmp_path):
    path = write_hand()
    home = tmp_path / "home"
    home.mkdir()
    (path.parent / "hand.yaml").rename(home / "hand.yaml")
    (home / "small.urdf").write_text(path.read_text().replace("package://small/wedge.stl", "../wedge.stl"))
    name, folder = path.parent.name, path.parent
    assert message(home / "small.urdf").endswith(f", or allow the folder that holds both: `packages` {name}={folder}")
    assert load_hand(home / "small.urdf", packages={name: folder}).num_joints == 3


def test_a_wrong_handed_mesh_is_turned_outward(write_hand, small):
    path = write_hand()
    path.write_text(path.read_text().replace('scale="0.001 0.002 0.001"', 'scale="0.001 -0.002 0.001"'))
    mesh = load_hand(path).link_meshes[5]
    assert mesh.volume == pytest.approx(small.link_meshes[5].volume, rel=1e-6)
    assert mesh.volume > 0.0


def test_a_collada_bomb_without_a_mesh(write_hand):
    path = write_hand()
    twice = "".join(f'<node id="n{k}">' + f'<instance_node url="#n{k + 1}"/>' * 2 + "</node>" for k in range(30))
    (path.parent / "wedge.dae").write_text(
        f'<COLLADA><library_nodes>{twice}<node id="n30"/></library_nodes><library_visual_scenes><visual_scene id="s"><node>'
        '<instance_node url="#n0"/></node></visual_scene></library_visual_scenes></COLLADA>'
    )
    path.write_text(path.read_text().replace("wedge.stl", "wedge.dae"))
    assert "places 4,294,967,296 nodes; expected at most 200,000" in message(path)


def test_limits_of_joints_that_only_place_the_hand_may_be_wide(write_hand, small):
    path = write_hand()
    above = """<link name="world"/><link name="cart"/>
    <joint name="along" type="prismatic"><parent link="world"/><child link="cart"/><limit lower="-20" upper="20"/></joint>
    <joint name="about" type="revolute"><parent link="cart"/><child link="forearm"/><limit lower="-20" upper="20"/></joint>
    </robot>"""
    path.write_text(path.read_text().replace("</robot>", above))
    assert load_hand(path).joint_names == small.joint_names


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "[0, -2, 0]",
            f"[0, 0, 1{'0' * 400}]",
            "; expected three numbers [x, y, z], not all zero",
        ),
        ("[[spin, near]]", "[[near, near]]", "coupling near <= near holds a joint to itself: expected pairs"),
        (
            "[[spin, near]]",
            "[[spin, near], [near, spin]]",
            "coupling spin <= near holds a joint to itself: expected pairs",
        ),
        (
            "base_link: forearm",
            "base_link: finger",
            "the hand's YAML names 'finger' as 'base_link', which is part of digit 'F': expected a link behind the palm",
        ),
    ],
)
@pytest.mark.filterwarnings("error")
def test_bad_facts(write_hand, old, new, expected):
    path = write_hand()
    config = path.parent / "hand.yaml"
    assert old in config.read_text()
    config.write_text(config.read_text().replace(old, new, 1))
    assert expected in message(path)


@pytest.mark.filterwarnings("error")
def test_a_direction_of_any_length_is_one(write_hand):
    path = write_hand(config=SMALL_YAML.replace("[0, -2, 0]", "[1.0e+300, 1.0e+300, 0]"))
    assert load_hand(path).palm_normal.tolist() == pytest.approx([0.5**0.5, 0.5**0.5, 0.0])


@pytest.mark.parametrize("packages", [["x"], {"x": None}, {3: "x"}, "x"])
def test_packages_are_names_and_folders(packages):
    with pytest.raises(HandError, match=r"`packages` is .*; expected names of packages and their folders"):
        check_packages(packages)


@pytest.mark.parametrize("link", ["root", "finger"])
def test_a_link_called_world_is_exported_so_that_mujoco_reads_it(write_hand, small, link):
    path = write_hand()
    if link == "root":
        mount = '<link name="world"/><joint name="m" type="fixed"><parent link="world"/><child link="forearm"/></joint>'
        path.write_text(path.read_text().replace("</robot>", f"{mount}</robot>"))
    else:
        path.write_text(path.read_text().replace('"finger"', '"world"'))
    hand = load_hand(path)
    model = mujoco.MjModel.from_xml_path(str(export_hand(hand, path.parent / "out").with_name("hand.xml")))
    names = [name.replace("world_link", "finger") for name in hand.link_names]
    assert names == list(small.link_names)
    assert sorted(model.body(name).id for name in hand.link_names) == list(range(1, len(names) + 1))
    q = torch.tensor([[0.0, 0, 0, 1, 0, 0, 0, 1, 0, 0.3, 0.5, -0.4]], dtype=torch.float64)
    assert torch.equal(hand.forward_kinematics(q), small.forward_kinematics(q))


def test_a_link_with_a_long_name_is_exported(write_hand):
    path = write_hand(config=SMALL_YAML)
    path.write_text(path.read_text().replace('"finger"', f'"{"f" * 300}"'))
    hand = load_hand(path)
    assert load_hand(export_hand(hand, path.parent / "out")).link_names == hand.link_names


PAIR = """<mujoco><compiler angle="radian"/>{top}<worldbody><body name="palm"><geom size="0.02"/>
<body name="a" pos="0.05 0 0"><joint name="a_j" axis="1 0 0" range="{range}"/><geom size="0.01"/></body></body></worldbody>
{end}</mujoco>"""


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        (
            {"range": "1.2 0"},
            "joint 'a_j': expected lower limit <= upper limit in 'range', got '1.2 0'; swap or mend them",
        ),
        ({"top": '<size nuser_jnt="100000000"/>'}, "<size nuser_jnt='100000000'>: expected what a robot consists of"),
        ({"top": '<size nuserdata="2000000000"/>'}, "<size nuserdata='2000000000'>: expected what a robot consists of"),
        ({"top": '<size memory="100000G"/>'}, "<size memory='100000G'>: expected what a robot consists of"),
        ({"end": '<keyframe><key qpos="nan"/></keyframe>'}, "<key>: expected finite numbers in 'qpos', got 'nan'"),
        (
            {"end": '<keyframe><key qpos="nan(1)"/></keyframe>'},
            "<key>: expected finite numbers in 'qpos', got 'nan(1)'",
        ),
    ],
)
def test_bad_mjcf(tmp_path, monkeypatch, capfd, part, expected):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "pair.xml"
    path.with_suffix(".yaml").write_text("palm: palm\nfingertips: {a: a}\npalm_normal: [0, 0, 1]")
    path.write_text(PAIR.format(**{"top": "", "range": "0 1.2", "end": "", **part}))
    assert expected in message(path)
    assert capfd.readouterr().err == ""
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_an_mjcf_axis_whose_square_overflows_is_refused(tmp_path):
    path = tmp_path / "pair.xml"
    path.with_suffix(".yaml").write_text("palm: palm\nfingertips: {a: a}\npalm_normal: [0, 0, 1]")
    path.write_text(PAIR.format(top="", range="0 1.2", end="").replace("1 0 0", "1e200 1e200 0"))
    assert message(path) == "joint 'a_j': expected an axis of some length from 1e-10 to 1e100; mend its `axis`"


@pytest.mark.parametrize("scale", ["e200", "e-200", "e-308"])
def test_an_axis_has_any_length(write_hand, scale):
    path = write_hand()
    before = [joint.axis for joint in load_hand(path).joints if joint is not None]
    path.write_text(path.read_text().replace('<axis xyz="0 3 4"/>', f'<axis xyz="0 3{scale} 4{scale}"/>'))
    after = [joint.axis for joint in load_hand(path).joints if joint is not None]
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(after, axis=1), 1.0)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("<limit ", '<limit velocity="-1" ', "expected a limit of velocity of at least 0, got -1; mend <limit>"),
        ("<limit ", '<limit effort="-1e9" ', "expected a limit of effort of at least 0, got -1e9; mend <limit>"),
        (
            'rpy="0 0 1"',
            'rpy="0 0 -1e300"',
            "expected angles of at most 1000 rad in 'rpy', got [0.0, 0.0, -1e+300]; mend <origin>",
        ),
        ('<axis xyz="0 3 4"/>', '<axis xyz="0 3 4"/><axis xyz="1 0 0"/>', "element of a joint name once, got ['axis']"),
        ('name="small"', f'name="{"s" * 1001}"', "expected at most 1000 printable characters; rename it"),
        ('"thumb"', '"th&#10;umb"', r"the name 'th\numb': expected at most 1000 printable characters; rename it"),
    ],
)
def test_what_stands_twice_and_names_that_are_none_are_refused(write_hand, old, new, expected):
    path = write_hand()
    path.write_text(path.read_text().replace(old, new))
    assert expected in message(path)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (SMALL_YAML + "palm: tip\n", "the key 'palm' twice"),
        (SMALL_YAML.replace("{F: pad", "{F: tip, F: pad"), "the key 'F' twice"),
        ("palm: " + "[" * 11 + "]" * 11, "lists in lists 10 deep at most"),
    ],
)
def test_a_yaml_says_each_thing_once_and_plainly(write_hand, text, expected):
    assert expected in message(write_hand(config=text))
