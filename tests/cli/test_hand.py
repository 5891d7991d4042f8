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


@pytest.fixture
def jaws(tmp_path):
    """Return the URDF of a gripper with two fingers that turn towards each other, in a folder of its own."""
    palm = '<link name="palm"><collision><geometry><box size="0.1 0.06 0.03"/></geometry></collision></link>'
    fingers = "".join(
        f'<link name="{side}"><collision><origin xyz="0 0 0.04"/><geometry><box size="0.02 0.02 0.08"/></geometry>'
        f'</collision></link><joint name="{side}_j" type="revolute"><parent link="palm"/><child link="{side}"/>'
        f'<origin xyz="{x} 0 0.02"/><axis xyz="0 {y} 0"/><limit lower="0" upper="1.2"/></joint>'
        for side, x, y in (("left", -0.05, 1), ("right", 0.05, -1))
    )
    path = tmp_path / "source" / "jaws.urdf"
    path.parent.mkdir()
    path.write_text(f'<robot name="jaws">{palm}{fingers}</robot>')
    return path


def contents(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_overwrite_replaces_what_was_prepared_and_nothing_else(dexnudge, jaws, tmp_path):
    out = tmp_path / "out"
    assert dexnudge("hand", jaws, "--prepare", out).code == 0
    (out / "meshes" / "mine.obj").write_text("mine")
    first = (out / "findings.json").read_bytes()
    assert dexnudge("hand", jaws, "--prepare", out, "--overwrite", "--palm-normal", 0, 0, 2).code == 0
    assert (out / "meshes" / "mine.obj").read_text() == "mine"
    assert (out / "findings.json").read_bytes() != first


@pytest.mark.parametrize("theirs", ["hand.urdf", "findings.json"])
def test_a_folder_that_was_not_prepared_stays_as_it_is(dexnudge, jaws, tmp_path, theirs):
    own = tmp_path / "own"
    (own / "meshes").mkdir(parents=True)
    (own / "meshes" / "mine.obj").write_text("mine")
    (own / theirs).write_text(jaws.read_text() if theirs == "hand.urdf" else '{"findings": []}')
    before = contents(own)
    outcome = dexnudge("hand", jaws, "--prepare", own, "--overwrite")
    assert outcome.code == 2
    assert "was not written by this command" in " ".join(outcome.err.split())
    assert contents(own) == before


def test_the_folder_of_what_is_read_is_never_replaced(dexnudge, jaws, tmp_path):
    out = tmp_path / "out"
    assert dexnudge("hand", jaws, "--prepare", out).code == 0
    for source in (out / "hand.urdf", out, jaws):
        folder = jaws.parent if source == jaws else out
        before = contents(folder)
        outcome = dexnudge("hand", source, "--prepare", folder, "--overwrite")
        assert outcome.code == 2
        assert "holds the description" in " ".join(outcome.err.split())
        assert contents(folder) == before


@pytest.mark.parametrize(("out", "said"), [("", "--prepare is ''"), ("a\0b", "without NUL")])
def test_a_folder_needs_a_name(dexnudge, jaws, out, said):
    for more in ([], ["--overwrite"]):
        outcome = dexnudge("hand", jaws, "--prepare", out, *more)
        assert outcome.code == 2
        assert said in " ".join(outcome.err.split())
