"""Forces for a block on its end that is tipped over its front edge, then pulled, by two pads and a palm behind it."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.sliding_task import GRAVITY, sliding_task
from dexnudge.planning.object_path import push_length, stations
from dexnudge.scenes.boxes import box
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.model import SimulationModel, scene_model
from dexnudge.simulation.push_forces import PINCH, PushForces, push_forces

WIDE, HIGH = 0.04, 0.12  # [m] of the block
PINCHED, BEHIND = 0.04, 0.10  # [m] over the table: the pads, and the palm
OPEN = 0.01  # [rad] of each pad's joint: 5 mm from the block
WEIGHT = 0.15 * GRAVITY


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Tipped by 15 degrees about the lower edge of its front, at x = 0, then pulled by 3 cm."""
    pose = np.eye(4)
    pose[:3, 3] = -WIDE / 2, 0.0, HIGH / 2
    table = box((-0.5, -0.3, -0.04), (0.5, 0.3, 0.0))
    turn = Turn(np.radians(15.0), np.array([0.0, 1.0, 0.0]), np.zeros(3))
    tall = trimesh.creation.box((WIDE, WIDE, HIGH))
    return Scene(tall, table, pose, np.array([1.0, 0.0, 0.0]), motion_length=0.03, turn=turn)


@pytest.fixture(scope="module")
def contacts(pad_grasp) -> HandContacts:
    """Four corners of each pad, and a point of the palm."""
    _, pads = pad_grasp
    return HandContacts(
        points=np.concatenate([pads.points + np.array([-WIDE / 2, 0.0, PINCHED]), [[-WIDE, 0.0, BEHIND]]]),
        normals=np.concatenate([pads.normals, [[-1.0, 0.0, 0.0]]]),
        link=np.append(pads.link, 0),
    )


@pytest.fixture(scope="module")
def simulation(pad_hand, scene) -> SimulationModel:
    return scene_model(pad_hand, scene)


@pytest.fixture(scope="module")
def q(pad_grasp) -> np.ndarray:
    found = np.array(pad_grasp[0])
    found[:3] += -WIDE / 2, 0.0, PINCHED
    return found


def planned(simulation: SimulationModel, q: np.ndarray, contacts: HandContacts, scene: Scene) -> PushForces:
    return push_forces(simulation, q, contacts, stations(scene, push_length(scene)), sliding_task(scene))


@pytest.fixture(scope="module")
def forces(simulation, q, contacts, scene) -> PushForces:
    return planned(simulation, q, contacts, scene)


@pytest.fixture(scope="module")
def slides(scene) -> np.ndarray:
    """Whether the block slides, at each station; else it tips."""
    return np.array([not each.twist.angular.any() for each in stations(scene, push_length(scene))])


def test_the_slide_begins_with_the_forces_with_which_the_tip_ends(forces, slides):
    first = int(np.argmax(slides))
    assert 0 < first < len(slides) - 1
    step = np.linalg.norm(forces.force[first] - forces.force[first - 1], axis=1)
    assert step.max() < 0.05 * np.linalg.norm(forces.force[first], axis=1).max()


def test_what_is_pulled_once_it_is_tipped_is_pinched_from_the_start_by_all_that_touches_its_sides(
    forces, simulation, q, contacts, scene
):
    np.testing.assert_allclose(forces.link_force[:, 1:], PINCH, rtol=0.01)
    np.testing.assert_array_equal(forces.link_force[:, 0], 0.0)  # behind it
    alone = planned(simulation, q, contacts, replace(scene, motion_length=0.0))  # the palm's push tips it as well
    np.testing.assert_array_equal(alone.link_force[:, 1:], 0.0)


def test_the_pinch_carries_the_block_as_closed_forms_say(forces, slides, contacts, scene):
    """About the edge on which it stands: the weight's moment. Along the table where it slides: mu (W - lift)."""
    reach, first = np.hypot(WIDE, HIGH) / 2, np.arctan2(HIGH, WIDE)
    places = stations(scene, push_length(scene))
    for place, sliding, made, surplus in zip(places, slides, forces.force, forces.surplus, strict=True):
        force = made / surplus
        angle = np.arccos(place.T[2, 2])
        moment = np.cross(contacts.points, force).sum(axis=0)[1]
        assert moment == pytest.approx(WEIGHT * reach * np.cos(first + angle), abs=0.03 * WEIGHT * HIGH / 2)
        along, _, lift = place.T[:3, :3] @ force.sum(axis=0)
        if sliding:
            assert along == pytest.approx(scene.friction_environment * (WEIGHT - lift), abs=0.03 * WEIGHT)


def test_no_link_is_planned_above_its_limit_however_hard_a_pinch_should_be(simulation, q, contacts, scene):
    weak = replace(scene, max_normal_force=PINCH - 1.0)
    assert planned(simulation, q, contacts, weak).link_force.max() < weak.max_normal_force


def test_a_link_that_hardly_presses_is_not_brought_to_the_object(simulation, q, scene):
    """Two links push the back, the upper one with 0.1 N: the lower one's pad closes, the upper one's stays open."""
    behind = HandContacts(
        points=np.array([[-WIDE, 0.0, 0.06], [-WIDE, 0.0, BEHIND]]),
        normals=np.tile([-1.0, 0.0, 0.0], (2, 1)),
        link=np.array([1, 2]),
    )
    opened = np.concatenate([q[:9], [-OPEN, -OPEN]])
    found = planned(simulation, opened, behind, replace(scene, motion_length=0.0))
    much, little = np.linalg.norm(found.force, axis=2).max(axis=0)
    assert 0.05 < little < 0.2 < 0.5 < much
    assert found.closing[0] == pytest.approx(OPEN, rel=0.05)
    assert found.closing[1] == 0.0
