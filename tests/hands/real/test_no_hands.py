"""Robots without a hand are refused, with what is missing."""

import pytest

from dexnudge.errors import HandError
from dexnudge.hands.link_meshes import package_file
from dexnudge.hands.preparation import prepare_hand

NO_HANDS = ("ur_description/urdf/ur5_robot.urdf", "urdf/double_pendulum.urdf")


@pytest.mark.parametrize("file", NO_HANDS)
def test_a_robot_without_a_hand_is_refused(file):
    path = package_file("example-robot-data", file, what="hand 'none'", install="pip install example-robot-data")
    with pytest.raises(HandError, match="no hand"):
        prepare_hand(path)
