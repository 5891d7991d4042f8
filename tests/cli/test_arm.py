"""`dexnudge arm`: what it prints, the picture, and what it refuses."""

import numpy as np
import pytest
from PIL import Image

import dexnudge as dn


def test_the_table_has_every_limit_and_the_mount_can_be_typed_again(dexnudge, tmp_path):
    outcome = dexnudge("arm", "panda", "--hand", "allegro", "--out", tmp_path / "out")
    assert outcome.code == 0, outcome.err
    lines = [" ".join(line.replace("│", " ").split()) for line in outcome.out.splitlines()]
    assert "panda_joint2 -1.7628 1.7628 -0.7854 2.175 7.5 3750 87" in lines
    assert any(line.startswith("base: panda_link0; flange: panda_link8, at home at (0.307, ") for line in lines)
    (typed,) = (line.split("--mount ")[1].split() for line in lines if "--mount" in line)
    again = dexnudge("arm", "panda", "--hand", "allegro", "--mount", *typed)
    assert again.out.splitlines()[-1] == outcome.out.splitlines()[-2]
    with Image.open(tmp_path / "out" / "arm.png") as picture:
        assert picture.size[0] > 1000
        assert np.asarray(picture).std() > 10
    taken = dexnudge("arm", "panda", "--out", tmp_path / "out")
    assert taken.code == 2
    assert "--overwrite" in taken.err
    assert dexnudge("arm", "panda", "--out", tmp_path / "out", "--overwrite").code == 0


def test_notes_say_what_was_assumed(dexnudge):
    outcome = dexnudge("arm", "ur5e")
    assert outcome.code == 0
    assert "note: no collision geometry: the hull of the visual one stands for it: base" in outcome.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["pandas"], "unknown arm 'pandas' (did you mean 'panda'?)"),
        (["panda", "--mount", "0", "0", "0"], "--mount given without --hand"),
        (["panda", "--hand", "allegro", "--mount", "0", "0", "-0.1"], "this mount turns the hand into the arm: "),
        (["panda", "--hand", "allegro", "--mount", "1", "2"], "--mount got 1 2; expected a JSON file, or X Y Z"),
        (["panda", "--package", "x"], "--package got 'x'; expected NAME=DIR"),
    ],
)
def test_what_cannot_be_is_refused(dexnudge, arguments, message):
    outcome = dexnudge("arm", *arguments)
    assert outcome.code == 2
    assert outcome.err.startswith(f"dexnudge: {message}")


def test_the_picture_shows_the_hand():
    from dexnudge.viewer.robot_pictures import arm_picture

    arm = dn.load_arm("panda")
    robot = dn.mount(arm, dn.load_hand("panda_gripper"))
    pictures = [arm_picture(shown, tile=(120, 130)) for shown in (arm, robot)]
    assert pictures[0].shape == pictures[1].shape == (130, 246, 3)
    assert (pictures[0] != pictures[1]).any()
    moved = dn.mount(arm.standing_at(np.diag([-1.0, -1.0, 1.0, 1.0])), dn.load_hand("panda_gripper"))
    assert (np.abs(arm_picture(moved, tile=(120, 130)).astype(int) - pictures[1]) < 3).all()
