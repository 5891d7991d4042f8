"""What is shown of a hand, against the description's own visual meshes as trimesh reads them; judged meshes stay."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import dexnudge as dn
from dexnudge.hands.export import export_hand
from dexnudge.hands.link_meshes import MOST_TRIANGLES, visual_meshes

URDF = """<robot name="toy">
<link name="palm">{palm}</link><link name="tip">{tip}</link>
<joint name="bend" type="revolute"><parent link="palm"/><child link="tip"/><origin xyz="0 0 0.05"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
YAML = "palm: palm\nfingertips: {one: tip}\npalm_normal: [1, 0, 0]\n"


def shape(kind, geometry, place="0 0 0"):
    return f'<{kind}><origin xyz="{place}"/><geometry>{geometry}</geometry></{kind}>'


def toy(folder, visual):
    box = shape("collision", '<box size="0.02 0.02 0.04"/>')
    (folder / "toy.urdf").write_text(URDF.format(palm=box, tip=box + visual))
    (folder / "toy.yaml").write_text(YAML)
    return dn.load_hand(folder / "toy.urdf")


@pytest.fixture
def fine(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.017)
    ball.export(tmp_path / "ball.stl")
    return toy(tmp_path, shape("visual", '<mesh filename="ball.stl"/>'))


def test_a_link_is_shown_by_its_visual_mesh_thinned_and_one_without_by_what_is_judged(fine):
    palm, tip = visual_meshes(fine)
    assert palm is fine.link_meshes[0]
    assert 500 < len(tip.faces) <= MOST_TRIANGLES
    np.testing.assert_allclose(np.linalg.norm(tip.vertices, axis=1), 0.017, atol=1e-3)
    assert fine.link_meshes[1].extents == pytest.approx([0.02, 0.02, 0.04])
    assert visual_meshes(replace(fine, shown_by=()))[1] is fine.link_meshes[1]


@pytest.mark.parametrize("place", ["0 0 0.2", "0.1 0 0"])
def test_what_is_shown_elsewhere_than_it_is_judged_is_not_shown(tmp_path, place):
    hand = toy(tmp_path, shape("visual", '<box size="0.03 0.03 0.05"/>', place))
    assert visual_meshes(hand)[1] is hand.link_meshes[1]


def test_a_missing_visual_mesh_is_no_error(tmp_path):
    hand = toy(tmp_path, shape("visual", '<mesh filename="nowhere.stl"/>'))
    assert visual_meshes(hand) == hand.link_meshes


def test_an_exported_hand_is_judged_and_shown_as_before(fine, tmp_path):
    there = dn.load_hand(export_hand(fine, tmp_path / "out"))
    for mine, its in zip(fine.link_meshes, there.link_meshes, strict=True):
        np.testing.assert_array_equal(mine.vertices, its.vertices)
    np.testing.assert_array_equal(visual_meshes(fine)[1].vertices, visual_meshes(there)[1].vertices)
