import numpy as np
import pytest
import trimesh

from dexnudge.planning.lying_object import lying_object
from dexnudge.planning.object_path import push_length
from dexnudge.scenes.boxes import box
from dexnudge.scenes.scene import Scene


def block_behind_an_edge(gap: float) -> Scene:
    """A block of 200 x 80 x 20 mm whose front end is `gap` [m] behind a table's edge; motion toward it."""
    pose = np.eye(4)
    pose[:3, 3] = -gap - 0.1, 0.0, 0.01
    table = box((-0.6, -0.3, -0.04), (0.0, 0.3, 0.0))
    return Scene(trimesh.creation.box((0.2, 0.08, 0.02)), table, pose, np.array([1.0, 0.0, 0.0]))


@pytest.mark.parametrize(("gap", "expected"), [(0.0, 0.06), (0.02, 0.08), (0.2, 0.1)])
def test_a_push_ends_where_three_tenths_of_the_length_hang_over(gap, expected):
    assert push_length(block_behind_an_edge(gap)) == pytest.approx(expected, abs=0.0055)


def test_a_push_that_leads_to_no_edge_has_its_whole_length():
    scene = block_behind_an_edge(0.2)
    sideways = Scene(scene.object_mesh, scene.environment_mesh, scene.T_world_object, np.array([-1.0, 0.0, 0.0]))
    assert push_length(sideways) == scene.motion_length


def test_a_worn_edge_of_a_scanned_board_does_not_turn_the_way():
    """The fitted plane says where along the support is; contacts on the worn edge lean by 30 degrees."""
    block = block_behind_an_edge(0.0)
    worn = trimesh.convex.convex_hull(
        [
            [x, y, z]
            for y in (-0.3, 0.3)
            for x, z in ((-0.6, 0.0), (-0.6, -0.04), (-0.004, 0.0), (0.0015, -0.003), (0.0015, -0.04))
        ]
    )
    scene = Scene(block.object_mesh, worn, block.T_world_object, block.motion, surface_noise=0.001)
    assert lying_object(scene).normal == pytest.approx([0.0, 0.0, 1.0], abs=1e-3)
    assert push_length(scene) == pytest.approx(push_length(block), abs=0.012)
