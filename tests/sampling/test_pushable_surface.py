"""Where a fingertip can work: places found on a slab in a slot, and hands that are drawn to them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_points import object_cloud
from dexnudge.geometry.warp_runtime import wp
from dexnudge.objects.builtin import builtin_object
from dexnudge.sampling.methods import find_method
from dexnudge.sampling.problem import (
    FACING_MOTION,
    PUSHABLE,
    ROOM,
    TIP_RADIUS,
    PushableSurface,
    places_with_room,
    prepare,
    pushable_surface,
)
from dexnudge.sampling.projection import packed_surface
from dexnudge.sampling.projection_kernel import Pushable, cannot_help, nearest_place
from dexnudge.sampling.sampler import DEFAULT_METHOD, Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.motion import Motion, Turn, Twist
from dexnudge.scenes.uncertainty import Uncertainty

FORWARD = torch.tensor([1.0, 0.0, 0.0])
SLIDE = [Twist(np.array([1.0, 0.0, 0.0]), np.zeros(3))]
LENGTH, HEIGHT, EXPOSED = 0.15, 0.01, 0.03  # [m] of the slab, and of what the upper board leaves of it


@wp.kernel(enable_backward=False)
def judge(
    pushable: Pushable,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    idle: wp.array(dtype=int),
    place: wp.array(dtype=wp.vec3),
):
    """Of each contact, whether it cannot help and the place nearest to its fingertip."""
    i = wp.tid()
    idle[i] = int(cannot_help(pushable, points[i], normals[i]))
    place[i] = nearest_place(pushable, points[i] + pushable.tip_radius * normals[i])


def judged(surface: PushableSurface, points: np.ndarray, normals: np.ndarray) -> tuple[list[bool], np.ndarray]:
    """Which contacts at `points` [m] with the object's outward `normals` are idle, and where each is drawn."""
    device = {"dtype": wp.vec3, "device": "cpu"}
    given = [wp.array(each.astype(np.float32), **device) for each in (points, normals)]
    found = [wp.zeros(len(points), dtype=int, device="cpu"), wp.zeros(len(points), **device)]
    packed = packed_surface(surface, drawn=True, device="cpu")
    wp.launch(judge, dim=len(points), inputs=[packed, *given], outputs=found, device="cpu")
    return found[0].numpy().astype(bool).tolist(), found[1].numpy()


@pytest.fixture(scope="module")
def slot():
    """A slab on a board; another board 1 mm above all but its front end, at x = 0.045 to 0.075."""
    slab = trimesh.creation.box((LENGTH, 0.07, HEIGHT))
    lower = trimesh.creation.box(bounds=((-0.3, -0.2, -0.025), (0.075, 0.2, -0.005)))
    upper = trimesh.creation.box(bounds=((-0.3, -0.2, 0.006), (0.075 - EXPOSED, 0.2, 0.026)))
    return object_cloud(slab), ExactDistance(trimesh.util.concatenate([lower, upper]))


def pushable(cloud, environment, twists=SLIDE, *, press_moves=True):
    return pushable_surface(*places_with_room(cloud, environment, clearance=0.0), twists, press_moves=press_moves)


def test_places_are_where_a_fingertip_fits_and_does_not_push_back(slot):
    cloud, environment = slot
    surface = pushable(cloud, environment)
    assert len(surface.places) > 0
    assert (environment(surface.places.double().numpy()).distance > ROOM).all()
    exposed = surface.places[:, 0] > 0.075 - EXPOSED - ROOM
    assert exposed.all(), "nothing under the upper board, nothing behind it"
    on_top = surface.places[:, 2] > HEIGHT / 2 + 0.9 * TIP_RADIUS
    assert on_top.any()
    in_front = surface.places[:, 0] > LENGTH / 2 + 0.5 * TIP_RADIUS
    assert not in_front.any()


def test_a_contact_that_faces_the_motion_is_idle(slot):
    cloud, environment = slot
    surface = pushable(cloud, environment)
    normals = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.8, 0.0, 0.6]])
    assert judged(surface, np.zeros((4, 3)), normals)[0] == [True, False, False, True]


def test_there_is_no_place_where_the_object_is_walled_in(slot):
    assert len(pushable(slot[0], ExactDistance(trimesh.creation.box((1.0, 1.0, 1.0)))).places) == 0


def test_where_no_press_moves_the_object_contacts_on_top_are_idle_and_drawn_to_its_sides(slot):
    cloud, environment = slot
    surface = pushable(cloud, environment, press_moves=False)
    assert len(surface.places) > 0
    assert (surface.places[:, 2] < HEIGHT / 2 + 0.5 * TIP_RADIUS + 1e-6).all()  # beside it, or around an edge
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    assert judged(surface, np.zeros((3, 3)), normals)[0] == [True, False, False]


def test_what_is_asked_for_is_what_the_hardest_world_needs():
    scene = build_scene("table", "phone", seed=0)
    uncertain = replace(
        scene, uncertainty=Uncertainty(friction=(0.5, 1.0), mass=(0.5, 2.0), max_normal_force=(0.5, 1.0))
    )
    easy, hard = prepare(scene), prepare(uncertain)
    assert easy.pushable.press_moves
    assert not hard.pushable.press_moves  # 0.4 at the hand and at the table
    (one,), (other,) = easy.balances, hard.balances
    assert other.friction_hand == pytest.approx(0.5 * one.friction_hand)
    assert other.max_normal == pytest.approx(one.max_normal / 4)  # half the force, twice the weight


def test_on_a_disk_that_turns_the_whole_rim_can_push_and_bumps_are_idle_where_they_run_ahead():
    """The rim moves along itself; a face square to it faces the turn by the sine of its angle to the radius."""
    radius = 0.05
    disk = trimesh.creation.cylinder(radius, 0.01, sections=256)
    turn = Turn(np.pi / 2, np.array([0.0, 0.0, 1.0]), np.zeros(3))
    surface = pushable(
        object_cloud(disk),
        ExactDistance(trimesh.creation.box((1.0, 1.0, 0.02)).apply_translation((0.0, 0.0, -0.015))),
        Motion(turn, np.array([1.0, 0.0, 0.0]), 0.0, radius).beginning_twists,
    )
    places = surface.places[surface.places[:, 2].abs() < 0.004]
    bearings = torch.atan2(places[:, 1], places[:, 0])
    assert torch.histc(bearings, bins=12, min=-np.pi, max=np.pi).min() > 0, "all around"
    bearing = np.linspace(0.0, 2 * np.pi, 33)[:-1]
    points = radius * np.stack([np.cos(bearing), np.sin(bearing), np.zeros_like(bearing)], axis=1)
    for lean in (0.0, 0.4, 0.6, -0.6, np.pi / 2):  # of the normal from the radius towards the turn [rad]
        normals = np.stack([np.cos(bearing + lean), np.sin(bearing + lean), np.zeros_like(bearing)], axis=1)
        assert judged(surface, points, normals)[0] == [np.sin(lean) > FACING_MOTION] * len(points)


def test_the_nearest_place_of_a_fingertip_in_front_is_on_the_exposed_end(slot):
    cloud, environment = slot
    surface = pushable(cloud, environment)
    touching = np.array([[LENGTH / 2, 0.0, 0.0]])
    place = torch.from_numpy(judged(surface, touching, FORWARD.numpy()[None])[1][0])
    distance = (surface.places - (torch.tensor(touching[0]) + TIP_RADIUS * FORWARD)).norm(dim=1)
    torch.testing.assert_close(place, surface.places[distance.argmin()])
    nearest = cloud[(cloud[:, :3] + TIP_RADIUS * cloud[:, 3:] - place).norm(dim=1).argmin()]
    assert float(nearest[3:] @ FORWARD) < PUSHABLE


@pytest.mark.slow
def test_more_draws_pull_out_of_a_slot_when_idle_fingertips_are_drawn_away(hand):
    """The same draws without the pull are the reference: where this was written 41 of 64 were verified, with it 58."""
    sampler, method = Sampler(hand), find_method(DEFAULT_METHOD)
    verified = {"with": 0, "without": 0}
    for seed, name in ((0, "phone-000"), (2, "phone-018")):
        scene = build_scene("slot", builtin_object(name), seed=seed)
        for pull, used in (("with", method), ("without", method.with_weights({"target": 0.0}))):
            verified[pull] += sampler.sample(scene, num=32, seed=seed, method=used).num_verified
    assert verified["with"] > verified["without"]
