"""What is shown of a draw, against the balance of forces, geometry in closed form, and colours that are known."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from dexnudge.mechanics.sliding_task import GRAVITY
from dexnudge.studio.draws import figures, listed
from dexnudge.studio.views import LONGEST_ARROW, clearance_colour, layers_of, link_clearance


@pytest.fixture(scope="module")
def layers(drawn):
    return layers_of(drawn[0])


def test_arrows_of_hand_and_supports_add_up_to_the_weight(drawn, layers):
    # Drawn to one scale, so that their sum, over the scale, is what carries the object: its weight, straight up.
    arrows = np.concatenate([layers.hand_forces, layers.support_forces])
    total = (arrows[:, 1] - arrows[:, 0]).sum(axis=0)
    normals = drawn[0].contacts.normals
    near = np.linalg.norm(layers.hand_forces[:, 1, None] - layers.contacts[None], axis=2).argmin(axis=1)
    pressed = -((layers.hand_forces[:, 1] - layers.hand_forces[:, 0]) * normals[near]).sum()
    newton = pressed / layers.pressed  # [m/N]
    assert total / newton == pytest.approx([0, 0, drawn.scene.mass * GRAVITY], abs=0.03)


def test_the_strongest_force_has_the_longest_arrow(layers):
    arrows = np.concatenate([layers.hand_forces, layers.support_forces])
    assert np.linalg.norm(arrows[:, 1] - arrows[:, 0], axis=1).max() == pytest.approx(LONGEST_ARROW)


def test_forces_of_the_hand_end_at_its_contacts(layers):
    gaps = np.linalg.norm(layers.hand_forces[:, 1, None] - layers.contacts[None], axis=2).min(axis=1)
    assert gaps.max() == pytest.approx(0, abs=1e-12)


def test_each_contact_has_a_pyramid_as_wide_as_its_friction(drawn, layers):
    pyramids = layers.cones.split(only_watertight=False)
    assert len(pyramids) == len(layers.contacts)
    for pyramid in pyramids:
        tip = np.linalg.norm(pyramid.vertices[:, None] - layers.contacts, axis=2).min(axis=1).argmin()
        apex = pyramid.vertices[tip]
        normal = drawn[0].contacts.normals[np.linalg.norm(layers.contacts - apex, axis=1).argmin()]
        edges = np.delete(pyramid.vertices, tip, axis=0) - apex
        along = edges @ normal
        across = np.linalg.norm(edges - along[:, None] * normal, axis=1)
        assert across / along == pytest.approx(np.full(8, drawn.scene.friction_hand))


def test_a_draw_that_nothing_balances_has_contacts_without_forces(drawn):
    heavy = replace(drawn.scene, mass=50.0)
    layers = layers_of(replace(drawn[0], scene=heavy))
    assert (layers.balanced, layers.pressed, len(layers.hand_forces)) == (False, 0.0, 0)
    assert len(layers.contacts) > 0


def test_clearance_from_a_floor_is_the_height_of_the_lowest_vertex(shadow_hand, drawn):
    floor = trimesh.creation.box((4, 4, 0.1))
    floor.apply_translation([0, 0, -0.55])  # its top is at -0.5
    scene = replace(drawn.scene, environment_mesh=floor)
    T = shadow_hand.forward_kinematics(torch.as_tensor(drawn.q[:1].astype(np.float64)))[0].numpy()
    found = link_clearance(scene, shadow_hand, drawn.q[0])
    for pose, mesh, clearance in zip(T, shadow_hand.link_meshes, found, strict=True):
        if len(mesh.faces) == 0:
            assert clearance == np.inf
            continue
        lowest = trimesh.transform_points(mesh.vertices, pose)[:, 2].min() + 0.5
        assert lowest - 1e-6 <= clearance <= lowest + 0.002  # points are up to 2 mm apart


@pytest.mark.parametrize(
    ("clearance", "colour"),
    [(-0.01, (0.85, 0.10, 0.16)), (0.01, (0.98, 0.80, 0.10)), (0.02, (0.74, 0.65, 0.30)), (np.inf, (0.5, 0.5, 0.5))],
)
def test_links_are_red_where_they_touch_and_keep_their_own_colour_far_away(clearance, colour):
    assert clearance_colour(clearance, (0.5, 0.5, 0.5)) == pytest.approx(colour)


def test_draws_are_listed_by_what_they_fail_best_first(drawn):
    reasons = ["", "", "contact", "force_margin", "contact", "force_margin", "force_margin", "force_margin"]
    success = np.array([not reason for reason in reasons])
    samples = replace(drawn, verdicts=replace(drawn.verdicts, reasons=reasons, success=success))
    assert {name: places.tolist() for name, places in listed(samples).items()} == {
        "all (8)": [0, 1, 2, 3, 4, 5, 6, 7],
        "verified (2)": [0, 1],
        "force_margin (4)": [3, 5, 6, 7],
        "contact (2)": [2, 4],
    }


def test_figures_tell_depths_in_millimetres_and_why_a_draw_fails(drawn, layers):
    values = {**drawn[0].values, "penetration_object": 0.00123, "force_margin": 1.5}
    rejected = replace(drawn[0], success=False, reason="penetration_object", values=values)
    rows = figures(rejected, 4, layers, sentence="it is inside")
    assert rows["configuration"] == "4"
    assert rows["verdict"] == "rejected: penetration_object"
    assert rows["which means"] == "it is inside"
    assert rows["penetration object"] == "1.23 mm"
    assert rows["force margin"] == "1.50"
