import numpy as np
import pytest
import trimesh

from dexnudge.errors import InputError
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.mechanics.sliding_task import SlidingTask, sliding_task
from dexnudge.scenes.motion import Twist
from dexnudge.scenes.scene import Scene


def test_centre_of_mass_of_a_closed_mesh_is_that_of_its_volume() -> None:
    cone = trimesh.creation.cone(radius=0.02, height=0.08, sections=256)
    np.testing.assert_allclose(centre_of_mass(cone), [0, 0, 0.02], atol=1e-6)  # a quarter of the height


@pytest.mark.parametrize("defect", ["open", "inside out"])
def test_a_mesh_without_volume_has_the_centre_of_its_hull(defect: str) -> None:
    box = trimesh.creation.box((0.1, 0.05, 0.01))
    box.apply_translation([1, 2, 3])
    if defect == "open":
        box.update_faces(np.arange(len(box.faces)) != 0)
    else:
        box.invert()
    np.testing.assert_allclose(centre_of_mass(box), [1, 2, 3], atol=1e-9)


def test_a_scene_gives_its_task_in_the_world() -> None:
    box = trimesh.creation.box((0.1, 0.05, 0.01))
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    pose[:3, 3] = [0.3, 0.2, 0.1]
    found = sliding_task(Scene(box, box, pose, np.array([0.0, 2.0, 0.0]), mass=0.2))
    np.testing.assert_allclose(found.centre, [0.3, 0.2, 0.1], atol=1e-12)
    np.testing.assert_allclose(found.twist.linear, [0, 1, 0])
    assert found.half_length == pytest.approx(0.05)
    assert found.weight == pytest.approx(0.2 * 9.81)


def test_values_outside_their_domain_are_named(task: SlidingTask) -> None:
    with pytest.raises(InputError, match=r"motion has length 2; expected a unit vector"):
        task.moving(Twist(np.array([2.0, 0.0, 0.0]), np.zeros(3)))
    with pytest.raises(InputError, match=r"mass is 0\.0; expected a finite number above 0"):
        SlidingTask(**{**task.__dict__, "mass": 0.0})
    with pytest.raises(InputError, match=r"friction_hand is nan; expected a finite number 0 or more"):
        SlidingTask(**{**task.__dict__, "friction_hand": float("nan")})
