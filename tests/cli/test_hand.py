"""`dexnudge hand`: what it prints, and an export that it can read itself."""

import os

import pytest
import yourdfpy


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    from dexnudge.cli.main import main

    folder = tmp_path_factory.mktemp("hand") / "out"
    assert main(["hand", "shadow_lite", "--prepare", str(folder)]) == 0
    return folder


def test_the_tables_name_joints_limits_digits_and_couplings(dexnudge, exported):
    outcome = dexnudge("hand", exported / "hand.urdf")
    assert outcome.code == 0
    assert "shadow_lite: 18 links, 16 joints in the order of q" in outcome.out
    lines = [" ".join(line.replace("│", " ").split()) for line in outcome.out.splitlines()]
    assert "FFJ4 -20.0 20.0" in lines
    assert "THJ1 -15.0 90.0" in lines
    assert "couplings: FFJ1 <= FFJ2, MFJ1 <= MFJ2, RFJ1 <= RFJ2" in lines
    assert any(line.startswith("ffdistal ffmiddle FF, tip") for line in lines)


def test_the_export_is_complete_and_another_reader_agrees(exported):
    files = ["findings.json", "hand.html", "hand.png", "hand.urdf", "hand.xml", "hand.yaml", "meshes"]
    assert sorted(os.listdir(exported)) == files
    robot = yourdfpy.URDF.load(str(exported / "hand.urdf"), load_meshes=False, load_collision_meshes=True)
    assert len(robot.actuated_joints) == 16
    assert robot.base_link == "palm"


def test_without_base_there_is_one_link_less(dexnudge, exported):
    outcome = dexnudge("hand", exported / "hand.urdf", "--no-base")
    assert outcome.code == 0
    assert "17 links" in outcome.out
