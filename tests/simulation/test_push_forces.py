"""Forces along a push: a block that comes over an edge, pressed by a palm in front of its centre and behind it."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.optimize import nnls

from dexnudge.mechanics.balance import balance_problem
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.friction_cone import wrenches
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.object_path import station, stations
from dexnudge.scenes.boxes import box
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.model import scene_model
from dexnudge.simulation.push_forces import HARDER, ROOM, SURPLUS, forces_with_reserve, push_forces

LENGTH, HEIGHT = 0.15, 0.02  # [m] of the block, whose front end is flush with the table's edge at x = 0
WAY = 0.06  # [m]
FRONT, REAR = -0.02, -0.10  # [m] where it is pressed on top


@pytest.fixture(scope="module")
def scene() -> Scene:
    pose = np.eye(4)
    pose[:3, 3] = -LENGTH / 2, 0.0, HEIGHT / 2
    table = box((-0.5, -0.3, -0.04), (0.0, 0.3, 0.0))
    return Scene(trimesh.creation.box((LENGTH, 0.06, HEIGHT)), table, pose, np.array([1.0, 0.0, 0.0]))


@pytest.fixture(scope="module")
def contacts() -> HandContacts:
    """The palm's, two abreast in front and two behind."""
    points = np.array([[x, y, HEIGHT] for x in (FRONT, REAR) for y in (-0.02, 0.02)])
    return HandContacts(points=points, normals=np.tile([0.0, 0.0, 1.0], (4, 1)), link=np.zeros(4, dtype=np.int64))


@pytest.fixture(scope="module")
def forces(pad_hand, scene, contacts):
    return forces_in(pad_hand, scene, contacts)


def forces_in(pad_hand, scene, contacts, made=push_forces):
    simulation = scene_model(pad_hand, scene)
    q = np.array([-LENGTH / 2, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    return made(simulation, q, contacts, stations(scene, WAY), sliding_task(scene))


def unbalanced(scene: Scene, contacts: HandContacts, force: np.ndarray, way: float) -> float:
    """What no forces of the table can balance of these of the hand, over the weight."""
    task, supports = sliding_task(scene), station(scene, way).supports
    problem = balance_problem(contacts, supports, task)
    hand = wrenches(contacts.points, force / task.weight, centre=task.centre, half_length=task.half_length).sum(axis=0)
    return float(nnls((problem.support_normal + problem.support_friction).T, -hand - problem.load)[1])


def test_a_place_every_centimetre(forces):
    assert forces.force.shape == (7, 4, 3)
    assert forces.base_wrench.shape == (7, 6)
    assert (forces.cone_share > 0).all()


def test_the_forces_balance_where_they_are_meant_to(scene, contacts, forces):
    for way, force, surplus in zip(np.linspace(0.0, WAY, 7), forces.force, forces.surplus, strict=True):
        assert unbalanced(scene, contacts, force / surplus, way) < 0.03


def test_the_hand_makes_more_than_that_but_no_more_than_a_link_may(pad_hand, scene, contacts, forces):
    pressed = -forces.force[:, :, 2].sum(axis=1)  # by the palm, its one link
    np.testing.assert_allclose(pressed, ROOM * scene.max_normal_force, rtol=2e-3)  # as far as the forces balance
    assert ((forces.surplus >= 1) & (forces.surplus < SURPLUS)).all()
    light = forces_in(pad_hand, replace(scene, mass=0.5 * scene.mass), contacts)
    assert (light.force[:, :, 2].sum(axis=1) > -scene.max_normal_force).all()
    np.testing.assert_array_equal(light.surplus, SURPLUS)


def test_the_reserve_balances_where_the_surroundings_are_rougher_and_is_left_out_where_nothing_does(
    pad_hand, scene, contacts
):
    light = replace(scene, mass=0.5 * scene.mass)
    rougher = replace(light, friction_environment=HARDER * light.friction_environment)
    found = forces_in(pad_hand, light, contacts, forces_with_reserve)
    for place, way in enumerate(np.linspace(0.0, WAY, 7)):
        planned, reserve = (made.force[place] / made.surplus[place] for made in (found, found.reserve))
        assert unbalanced(light, contacts, planned, way) < 0.03
        assert unbalanced(rougher, contacts, planned, way) > 0.1
        assert unbalanced(rougher, contacts, reserve, way) < 0.03
    slippery = replace(light, friction_hand=1.2 * light.friction_environment)
    assert forces_in(pad_hand, slippery, contacts, forces_with_reserve).reserve is None


def test_the_block_would_tip_over_the_edge_under_the_forces_of_the_beginning(scene, contacts, forces):
    assert unbalanced(scene, contacts, forces.force[0] / forces.surplus[0], WAY) > 0.1
    front = forces.force[:, :2, 2].sum(axis=1) / forces.force[:, :, 2].sum(axis=1)
    assert front[-1] < 0.9 * front[0]


def test_the_base_presses_with_what_the_hand_does(forces):
    np.testing.assert_allclose(forces.base_wrench[:, :3], forces.force.sum(axis=1), atol=1e-12)
