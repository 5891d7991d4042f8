"""The fused kernel against a plain twin: torch, double precision, one hand and one pair of links at a time, autograd."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from moves import rotation_vector_to_matrix

from dexnudge.energies.descent import HandPose
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.kernel_inputs import (
    FAR_CELL,
    FAR_REACH,
    NEAR_CELL,
    NEAR_PADDING,
    OBJECT_CELL,
    OBJECT_PADDING,
    _link_grid,
    build_guided_fields,
    build_scene_fields,
    swept_grid,
)
from dexnudge.energies.terms import TermWeights
from dexnudge.errors import InputError
from dexnudge.geometry.distance_grid import DistanceGrid, distance_grid
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.transforms import matrix_to_rotation_6d
from dexnudge.hands.named.shadow import shadow_lite
from dexnudge.scenes.motion import Motion

BATCH = 4
WAY = np.array([0.1, 0.0, 0.0])  # [m] of the motion
MOTION = Motion(None, WAY / 0.1, 0.1)
WEIGHTS = TermWeights(
    environment=1.0,
    object=2.0,
    self=0.5,
    contact=3.0,
    target=1.5,
    sweep=0.7,
    base=0.4,
    clearance_object=0.001,
    clearance_base=0.03,
)


def trilinear(grid: DistanceGrid, points: torch.Tensor) -> torch.Tensor:
    """Distances by the definition of trilinear interpolation, plus the distance to the box where outside."""
    values = torch.as_tensor(grid.values, dtype=torch.float64)
    origin = torch.as_tensor(np.asarray(grid.origin, dtype=np.float32).astype(np.float64))
    position = (points - origin) / grid.cell
    top = torch.as_tensor(grid.values.shape, dtype=torch.float64) - 1 - 1.0e-4
    inside = torch.minimum(position.clamp_min(0.0), top)
    low = inside.detach().floor().long()
    weight = inside - low
    total = torch.zeros(len(points), dtype=torch.float64)
    for corner in np.ndindex(2, 2, 2):
        at = low + torch.as_tensor(corner)
        share = torch.ones(len(points), dtype=torch.float64)
        for axis in range(3):
            share = share * (weight[:, axis] if corner[axis] else 1 - weight[:, axis])
        total = total + share * values[at[:, 0], at[:, 1], at[:, 2]]
    beyond = (position - inside) * grid.cell
    gap = beyond.norm(dim=1)
    return torch.where(gap > 0.01 * grid.cell, total.detach() + gap, total)


def in_box(grid: DistanceGrid, points: torch.Tensor) -> torch.Tensor:
    position = (points.detach() - torch.as_tensor(np.asarray(grid.origin, np.float32).astype(np.float64))) / grid.cell
    top = torch.as_tensor(grid.values.shape, dtype=torch.float64) - 1
    return ((position >= 0) & (position <= top)).all(dim=1)


class NaiveEnergy:
    """The terms as `energies` defines them, without culling, fusion or hand-written derivatives."""

    def __init__(self, hand, object_mesh, environment_mesh):
        self.hand, self.environment_mesh = hand, environment_mesh
        lower, upper = object_mesh.bounds
        exact, around = ExactDistance(object_mesh), ExactDistance(environment_mesh)
        self.object_grid = distance_grid(exact, lower - OBJECT_PADDING, upper + OBJECT_PADDING, cell=OBJECT_CELL)
        self.near = distance_grid(around, lower - NEAR_PADDING, upper + NEAR_PADDING, cell=NEAR_CELL)
        self.far = distance_grid(around, lower - FAR_REACH, upper + FAR_REACH, cell=FAR_CELL)
        self.links = [_link_grid(hand, link, "cpu") for link in range(len(hand.link_names))]
        self.swept_near, self.swept_far = swept_grid(self.near, WAY, around=self.far), swept_grid(self.far, WAY)
        fields = build_guided_fields(object_mesh, environment_mesh, guiding=False, motion=MOTION)[0]
        self.fields = fields
        self.fixed = {
            "object": torch.as_tensor(fields.object_points.numpy(), dtype=torch.float64),
            "environment": torch.as_tensor(fields.environment_points.numpy(), dtype=torch.float64),
        }

    def environment_distance(self, points):
        return torch.where(in_box(self.near, points), trilinear(self.near, points), trilinear(self.far, points))

    def swept_distance(self, points):
        near, far = trilinear(self.swept_near, points), trilinear(self.swept_far, points)
        return torch.where(in_box(self.near, points), near, far)

    def __call__(self, q, contact_weight, target, target_weight):
        """(7,) terms of ONE hand, differentiable in q."""
        hand, w = self.hand, WEIGHTS
        transforms = hand.forward_kinematics(q[None])[0]
        sparse = hand.sparse_points
        terms = torch.zeros(7, dtype=torch.float64)
        own = {}
        for link in range(len(hand.link_names)):
            local = torch.as_tensor(sparse.points[sparse.link == link].astype(np.float32), dtype=torch.float64)
            own[link] = local @ transforms[link, :3, :3].T + transforms[link, :3, 3]
        solid = [link for link in own if len(own[link])]
        for link in solid:
            depth = (w.clearance_environment - self.environment_distance(own[link])).clamp_min(0)
            terms[0] = terms[0] + w.environment * depth.square().sum()
            on_the_way = (w.clearance_environment - self.swept_distance(own[link])).clamp_min(0)
            terms[5] = terms[5] + (w.sweep * on_the_way.square() - min(w.sweep, w.environment) * depth.square()).sum()
            if hand.link_names[link] == hand.base_link:
                close = (w.clearance_base - self.environment_distance(own[link])).clamp_min(0)
                terms[6] = terms[6] + w.base * close.square().sum()
            distance = trilinear(self.object_grid, own[link])
            terms[1] = terms[1] + w.object * (w.clearance_object - distance).clamp_min(0).square().sum()
            if contact_weight[link] > 0:
                gap = distance.min() - w.contact_gap
                terms[3] = terms[3] + w.contact * contact_weight[link] * gap.square()
            for index, name, clearance, weight in (
                (1, "object", w.clearance_object, w.object),
                (0, "environment", w.clearance_environment, w.environment),
            ):
                back = (self.fixed[name] - transforms[link, :3, 3]) @ transforms[link, :3, :3]
                back = back[in_box(self.links[link], back)]
                hinge = (clearance - trilinear(self.links[link], back)).clamp_min(0)
                terms[index] = terms[index] + weight * hinge.square().sum()
            if target_weight[link] > 0:
                keypoint = hand.keypoints(q[None])[0, hand.fingertip_links.index(hand.link_names[link])]
                terms[4] = terms[4] + w.target * target_weight[link] * (keypoint - target[link]).square().sum()
        for one, other in hand.self_collision_pairs:
            for a, b in ((one, other), (other, one)):
                back = (own[a] - transforms[b, :3, 3]) @ transforms[b, :3, :3]
                back = back[in_box(self.links[b], back)]
                hinge = (w.clearance_self - trilinear(self.links[b], back)).clamp_min(0)
                terms[2] = terms[2] + w.self * hinge.square().sum()
        return terms


@pytest.fixture(scope="module")
def setting():
    return placed(shadow_lite(), torch.tensor([1.0, 0.5, 0.0, 1.0]), torch.tensor([0.0, 1.0, 1.0, 0.3]))


@pytest.fixture(scope="module")
def gripper_setting(two_jaws):
    made = placed(two_jaws, torch.tensor([1.0, 0.5]), torch.tensor([0.3, 1.0]))
    made[-1].joint_angles[0] = 0.0001  # [m] the jaws all but touch
    return made


def placed(hand, contact_weight, target_weight):
    object_mesh = trimesh.creation.box((0.14, 0.07, 0.012))
    environment = trimesh.creation.box((0.5, 0.4, 0.1))
    environment.apply_translation((0.2, 0.1, -0.006 - 0.05))
    ahead = trimesh.creation.box((0.03, 0.2, 0.2)).apply_translation((0.18, 0.0, 0.1))
    environment = trimesh.util.concatenate([environment, ahead])
    naive = NaiveEnergy(hand, object_mesh, environment)
    generator = np.random.default_rng(7)
    rotation = rotation_vector_to_matrix(torch.as_tensor(generator.normal(size=(BATCH, 3)) * 2, dtype=torch.float32))
    translation = torch.as_tensor(generator.normal(0.0, 0.06, (BATCH, 3)), dtype=torch.float32)
    share = generator.uniform(0.2, 1.0, (BATCH, hand.num_joints))
    joints = torch.as_tensor(hand.lower + share * (hand.upper - hand.lower), dtype=torch.float32)
    energy = HandEnergy(hand, naive.fields, BATCH, WEIGHTS)
    tips = hand.fingertip_indices
    energy.contact_weight[:, tips] = contact_weight
    energy.target[:, tips] = 0.02
    energy.target_weight[:, tips] = target_weight
    return hand, naive, energy, HandPose(translation, rotation, joints)


@pytest.mark.parametrize("name", ["setting", "gripper_setting"])
def test_terms_and_gradient_equal_the_plain_twin(request, name):
    hand, naive, energy, pose = request.getfixturevalue(name)
    energy(pose)
    assert (energy.energy > 0).any(dim=0).all(), "every term must be at work in some hand"
    for item in range(BATCH):
        tangent = torch.zeros(6 + hand.num_joints, dtype=torch.float64, requires_grad=True)
        rotation = rotation_vector_to_matrix(tangent[None, 3:6])[0] @ pose.rotation[item].double()
        q = torch.cat(
            [
                pose.translation[item].double() + tangent[:3],
                matrix_to_rotation_6d(rotation),
                pose.joint_angles[item].double() + tangent[6:],
            ]
        )
        weights = (energy.contact_weight[item], energy.target[item].double(), energy.target_weight[item])
        terms = naive(q, *weights)
        (gradient,) = torch.autograd.grad(terms.sum(), tangent)
        torch.testing.assert_close(energy.energy[item].double(), terms.detach(), rtol=1e-3, atol=1e-5)
        torch.testing.assert_close(
            energy.gradient[item].double(), gradient, rtol=2e-3, atol=2e-3 * float(gradient.abs().max())
        )


def test_fingertip_contacts_alone_are_those_of_the_whole_energy(setting):
    hand, naive, _, pose = setting
    tips = hand.fingertip_indices
    whole, alone = (HandEnergy(hand, naive.fields, BATCH, WEIGHTS) for _ in range(2))
    whole.contact_weight[:, tips] = 1.0
    whole(pose)
    alone.find_fingertip_contacts(pose)
    assert (whole.contact_distance[:, tips] < 1.0).all()
    for name in ("contact_distance", "contact_point", "contact_normal"):
        assert torch.equal(getattr(alone, name)[:, tips], getattr(whole, name)[:, tips])
    alone.contact_weight.copy_(whole.contact_weight)
    assert torch.equal(alone(pose), whole(pose)), "nothing of it is left over"
    assert torch.equal(alone.gradient, whole.gradient)


def test_samples_do_not_feel_their_neighbours(setting):
    hand, naive, energy, pose = setting
    together = energy(pose).clone()
    alone = HandEnergy(hand, naive.fields, 1, WEIGHTS)
    for name in ("contact_weight", "target", "target_weight"):
        getattr(alone, name).copy_(getattr(energy, name)[2:3])
    single = alone(HandPose(pose.translation[2:3], pose.rotation[2:3], pose.joint_angles[2:3]))
    assert float(single[0]) == float(together[2])
    assert torch.equal(alone.gradient[0], energy.gradient[2])


def test_a_clearance_of_the_scene_adds_to_those_of_the_weights_and_depths_count_from_it(setting):
    hand, naive, _, pose = setting
    kept, fields = 0.0015, naive.fields
    wider = replace(
        WEIGHTS,
        clearance_environment=WEIGHTS.clearance_environment + kept,
        clearance_base=WEIGHTS.clearance_base + kept,
    )
    plain, by_weights = (HandEnergy(hand, fields, BATCH, weights) for weights in (WEIGHTS, wider))
    by_scene = HandEnergy(hand, fields, BATCH, WEIGHTS, clearance=kept)
    total, wanted, _ = by_scene(pose).clone(), by_weights(pose).clone(), plain(pose)
    torch.testing.assert_close(total, wanted)
    torch.testing.assert_close(by_scene.gradient, by_weights.gradient)
    inside = plain.depth[..., 0] > 0
    assert inside.any()
    torch.testing.assert_close(by_scene.depth[..., 0][inside], plain.depth[..., 0][inside] + kept)
    assert (by_scene.depth[..., 0] > 0).sum() > inside.sum()
    assert (by_scene.swept_depth >= plain.swept_depth).all()
    assert torch.equal(by_scene.depth[..., 1:], plain.depth[..., 1:])


def test_a_hand_far_away_costs_nothing_but_its_contacts(setting):
    hand, naive, _, pose = setting
    energy = HandEnergy(hand, naive.fields, BATCH, TermWeights())
    straight = torch.zeros_like(pose.joint_angles)
    energy(HandPose(pose.translation + 3.0, pose.rotation, straight))
    assert float(energy.energy.abs().max()) == 0.0
    assert float(energy.gradient.abs().max()) == 0.0


def evaluated(setting, fields, weights):
    hand, _, _, pose = setting
    energy = HandEnergy(hand, fields, BATCH, weights)
    energy(pose)
    return energy


@pytest.mark.parametrize(
    ("name", "column"), [("environment", 0), ("object", 1), ("self", 2), ("sweep", 5), ("base", 6)]
)
def test_a_weight_of_zero_switches_its_term_off_and_leaves_the_others(setting, name, column):
    on = evaluated(setting, setting[1].fields, WEIGHTS)
    off = evaluated(setting, setting[1].fields, replace(WEIGHTS, **{name: 0.0}))
    assert float(on.energy[:, column].max()) > 0
    assert float(off.energy[:, column].abs().max()) == 0.0
    # What the way adds is over and above the environment's term, so it depends on that weight.
    dependent = {column, 5} if name == "environment" else {column}
    others = [term for term in range(on.energy.shape[1]) if term not in dependent]
    torch.testing.assert_close(off.energy[:, others], on.energy[:, others], rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("sweep", [1.0, 5.0])
def test_what_the_way_adds_is_never_negative_and_without_the_place_it_is_all_of_it(setting, sweep):
    fields = setting[1].fields
    both, alone = (evaluated(setting, fields, replace(WEIGHTS, sweep=sweep, environment=e)) for e in (1.0, 0.0))
    unit = evaluated(setting, fields, replace(WEIGHTS, sweep=1.0, environment=0.0))
    torch.testing.assert_close(alone.energy[:, 5], sweep * unit.energy[:, 5], rtol=1e-4, atol=1e-8)
    here = evaluated(setting, fields, replace(WEIGHTS, sweep=0.5)).energy[:, 5] - 0.5 * unit.energy[:, 5]
    assert float(here.min()) < 0
    assert (both.energy[:, 5] >= 0).all()
    torch.testing.assert_close(both.energy[:, 5], alone.energy[:, 5] + 2.0 * here, rtol=1e-3, atol=1e-6)


def test_sweep_does_nothing_where_the_fields_were_not_swept(setting):
    naive = setting[1]
    body = trimesh.creation.box((0.14, 0.07, 0.012))
    plain = evaluated(setting, build_scene_fields(body, naive.environment_mesh), WEIGHTS)
    swept = evaluated(setting, naive.fields, WEIGHTS)
    assert float(plain.energy[:, 5].abs().max()) == 0.0
    assert float(plain.swept_depth.max()) == 0.0
    assert float(swept.swept_depth.amax()) >= float(swept.depth[:, :, 0].amax())
    torch.testing.assert_close(plain.energy[:, :5], swept.energy[:, :5], rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf"), 1e300])
@pytest.mark.parametrize("name", ["sweep", "force", "clearance_base"])
def test_weights_that_make_no_sense_are_refused(name, value):
    what, off = ("distance", "") if name == "clearance_base" else ("weight", "; 0 switches it off")
    with pytest.raises(InputError) as caught:
        TermWeights(**{name: value})
    assert (
        str(caught.value) == f"the {what} '{name}' of the energy is {value:g}; expected a number from 0 to 1e+06{off}"
    )
