"""What a URDF's elements become: links, joints, limits and geometry."""

import numpy as np
import pytest
import trimesh

from dexnudge.hands.config import HandConfig, read_hand_config
from dexnudge.hands.registry import load_hand
from dexnudge.hands.urdf import hand_from_urdf


def mesh_of(hand, link):
    return hand.link_meshes[hand.link_names.index(link)]


def test_links_and_joints_keep_the_files_order(small):
    assert small.link_names == ("palm", "forearm", "thumb", "finger", "tip", "thumbtip", "pad")
    assert small.joint_names == ("wrist", "near", "spin")
    assert small.digit_of_link == {
        "palm": None, "forearm": None, "thumb": "T", "thumbtip": "T", "finger": "F", "tip": "F", "pad": "F",
    }  # fmt: skip


def test_limits(small):
    np.testing.assert_allclose(small.lower, (-0.5, 0.0, -np.pi))
    np.testing.assert_allclose(small.upper, (0.7, 1.2, np.pi))
    np.testing.assert_allclose(small.palm_normal, (0, -1, 0))


def test_box_and_cylinder_of_one_link_are_taken_together(small):
    palm = mesh_of(small, "palm")
    np.testing.assert_allclose(palm.bounds, [(-0.03, -0.01, -0.04), (0.03, 0.02, 0.045)], atol=3e-5)
    assert palm.body_count == 2


@pytest.mark.parametrize(
    ("link", "volume"),
    [("finger", np.pi * 0.008**2 * 0.05), ("tip", 4 / 3 * np.pi * 0.009**3), ("pad", 0.01 * 0.01 * 0.004)],
)
def test_volumes_of_basic_shapes(small, link, volume):
    assert mesh_of(small, link).is_watertight
    assert mesh_of(small, link).volume == pytest.approx(volume, rel=0.01)
    assert mesh_of(small, link).volume <= volume * (1 + 1e-9)  # inscribed


def test_mesh_is_scaled_per_axis(small):
    cone = mesh_of(small, "thumbtip")
    np.testing.assert_allclose(cone.bounds, [(-0.01, -0.02, 0.01), (0.01, 0.02, 0.03)], atol=1e-4)


def test_link_without_collision_is_empty_and_visuals_are_not_mixed_in(small):
    assert len(mesh_of(small, "thumb").faces) == 0
    assert mesh_of(small, "palm").extents.max() < 0.1


def test_visual_geometry_on_request(write_hand):
    config = HandConfig("palm", {"F": "pad"}, (0.0, 1.0, 0.0), geometry="visual")
    path = write_hand()
    ball = "<visual><geometry><sphere radius='0.004'/></geometry></visual>"
    path.write_text(path.read_text().replace('<link name="pad">', f'<link name="pad">{ball}'))
    hand = hand_from_urdf(path, config)
    assert mesh_of(hand, "palm").extents == pytest.approx((0.6, 0.6, 0.6), abs=0.01)
    assert len(mesh_of(hand, "tip").faces) == 0


def test_without_base_the_arm_is_gone(small_urdf):
    hand = load_hand(small_urdf, base=False)
    assert hand.link_names == ("palm", "thumb", "finger", "tip", "thumbtip", "pad")
    assert hand.joint_names == ("near", "spin")
    assert hand.base_link is None


def test_base_keeps_links_that_lead_to_a_fingertip(write_hand):
    # A palm in the middle of the chain: the thumb hangs from the forearm, behind the palm.
    path = write_hand()
    path.write_text(
        path.read_text().replace(
            '<parent link="palm"/><child link="thumb"/>', '<parent link="forearm"/><child link="thumb"/>'
        )
    )
    hand = load_hand(path, base=False)
    assert hand.link_names == ("palm", "forearm", "thumb", "finger", "tip", "thumbtip", "pad")


def test_yaml_named_after_the_urdf_comes_first(write_hand):
    path = write_hand()
    path.with_suffix(".yaml").write_text("palm: finger\nfingertips: {F: pad}\npalm_normal: [0, 0, 1]\nname: other")
    assert load_hand(path).name == "other"
    assert load_hand(path).link_names[0] == "finger"
    assert hand_from_urdf(path, read_hand_config(path.with_name("hand.yaml"))).name == "small"
    assert read_hand_config(path.with_suffix(".yaml")).palm_normal == (0.0, 0.0, 1.0)


def test_inside_out_mesh_is_turned(write_hand):
    path = write_hand()
    mesh = trimesh.load_mesh(path.parent / "wedge.stl")
    mesh.invert()
    mesh.export(path.parent / "wedge.stl")
    assert mesh_of(load_hand(path), "thumbtip").volume > 0


def test_mesh_formats(write_hand):
    path = write_hand()
    text = path.read_text()
    reference = mesh_of(load_hand(path), "thumbtip")
    for suffix in ("obj", "ply", "dae"):
        trimesh.load_mesh(path.parent / "wedge.stl").export(path.parent / f"wedge.{suffix}")
        path.write_text(text.replace("wedge.stl", f"wedge.{suffix}"))
        mesh = mesh_of(load_hand(path), "thumbtip")
        np.testing.assert_allclose(mesh.bounds, reference.bounds, atol=1e-6, err_msg=suffix)
        assert mesh.volume == pytest.approx(reference.volume, rel=1e-4)


def test_an_empty_tip_counts_as_the_link_before_it(write_hand):
    path = write_hand(config="palm: palm\nfingertips: {F: end, T: thumbtip}\npalm_normal: [0, -2, 0]")
    joint = '<joint name="endmount" type="fixed"><parent link="pad"/><child link="end"/></joint>'
    path.write_text(path.read_text().replace("</robot>", f'<link name="end"/>{joint}</robot>'))
    hand = load_hand(path)
    assert hand.fingertips == {"F": "pad", "T": "thumbtip"}
    assert hand.notes == ("'end' has no geometry: 'pad' counts as the tip of F",)
    assert hand.fingertip_keypoints.shape == (2, 3)


def test_a_fixed_joint_needs_no_axis(write_hand):
    path = write_hand()
    path.write_text(path.read_text().replace('rpy="0 0 1"/></joint>', 'rpy="0 0 1"/><axis xyz="0 0 0"/></joint>'))
    assert load_hand(path).num_joints == 3


@pytest.mark.parametrize("kind", ["prismatic", "floating", "planar"])
def test_joints_that_place_the_hand_are_cut_off(write_hand, small, kind):
    path = write_hand()
    above = f"""<link name="world"/><link name="cart"/>
    <joint name="virtual_0" type="{kind}"><parent link="world"/><child link="cart"/><axis xyz="0 0 1"/></joint>
    <joint name="virtual_1" type="continuous"><parent link="cart"/><child link="forearm"/></joint></robot>"""
    path.write_text(path.read_text().replace("</robot>", above))
    hand = load_hand(path)
    assert (hand.joint_names, hand.link_names) == (small.joint_names, small.link_names)
    assert hand.notes == ("joints that place the hand in the world were cut off: virtual_0, virtual_1",)


@pytest.mark.parametrize(
    "name", ["package://some_hand/meshes/WEDGE.STL", "package:///some_hand/meshes/WEDGE.STL", "../meshes/WEDGE.STL"]
)
@pytest.mark.parametrize("manifest", [True, False])
def test_meshes_of_a_ros_package_are_found(write_hand, name, manifest, small):
    path = write_hand()
    package = path.parent / "some_hand"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    (path.parent / "wedge.stl").rename(package / "meshes" / "WEDGE.STL")
    (path.parent / "hand.yaml").rename(package / "urdf" / "hand.yaml")
    if manifest:
        (package / "package.xml").write_text("<package><name>some_hand</name></package>")
    moved = package / "urdf" / "small.urdf"
    moved.write_text(path.read_text().replace("package://small/wedge.stl", name))
    np.testing.assert_array_equal(mesh_of(load_hand(moved), "thumbtip").vertices, mesh_of(small, "thumbtip").vertices)
