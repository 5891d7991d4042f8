"""A measured world becomes a scene: planes for what carries the object, a resting object, a motion along its support."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
from trimesh.transformations import rotation_matrix

import dexnudge as dn
from dexnudge.scenes.scene import Scene

TRIANGLE = 0.008  # [m]


@cache
def clean(family: str = "layers") -> Scene:
    return dn.build_scene(family, "phone", seed=0)


def as_scanned(mesh: trimesh.Trimesh, *, noise: float, seed: int = 0) -> trimesh.Trimesh:
    """The mesh in 8 mm triangles, its vertices moved along their normals."""
    fine = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, TRIANGLE))
    moves = np.random.default_rng(seed).normal(scale=noise, size=(len(fine.vertices), 1)) * fine.vertex_normals
    return trimesh.Trimesh(fine.vertices + moves, fine.faces, process=False)


def understood(scene: Scene, **changes: object) -> Scene:
    given = {
        "environment": scene.environment_mesh,
        "object_pose": scene.T_world_object,
        "motion": scene.motion,
        **changes,
    }
    return Scene.from_files(scene.object_mesh, **given)  # type: ignore[arg-type]


def turned(scene: Scene, degrees: float) -> np.ndarray:
    middle = scene.T_world_object[:3, 3]
    return rotation_matrix(np.radians(degrees), [0.6, 0.8, 0.0], middle) @ scene.T_world_object


@pytest.mark.parametrize("family", ["table", "layers", "shelf", "ramp", "stack", "corner"])
def test_a_clean_world_stays_as_it_is(family: str) -> None:
    scene = clean(family)
    same = understood(scene)
    assert same.environment_mesh is scene.environment_mesh
    assert np.array_equal(same.T_world_object, scene.T_world_object)
    assert np.array_equal(same.motion, scene.motion)
    assert (same.surface_noise, same.clearance, same.notes, same.parameters) == (0.0, 0.0, [], {})
    assert same.supports[0].side == "below"


@pytest.mark.parametrize("noise", [0.0005, 0.001, 0.002])
def test_noise_is_measured_and_the_object_comes_to_rest_on_the_true_plane(noise: float) -> None:
    scene = clean()
    pose = turned(scene, 1.0)
    pose[2, 3] += 0.002
    found = understood(scene, environment=as_scanned(scene.environment_mesh, noise=noise), object_pose=pose)
    assert found.surface_noise == pytest.approx(noise, rel=0.25)
    assert found.clearance == found.surface_noise
    support = found.supports[0]
    assert support.tilt < 0.06 * noise / 0.001
    centre = scene.T_world_object[:3, 3]
    assert abs(support.height(centre[None])[0] - centre[2]) < 0.25 * noise
    assert (found.T_world_object[:3, 3] - pose[:3, 3])[2] == pytest.approx(-0.002, abs=0.0003 + 0.25 * noise)
    # all that carries it is one plane, to the precision of its file
    supports = [normal for normal in found.environment_mesh.face_normals if normal @ support.normal > 1 - 1e-9]
    assert len(supports) > 100
    assert any("scatters" in note for note in found.notes)


def test_rounded_coordinates_are_no_noise_and_block_nothing() -> None:
    scene = clean()
    rounded = as_scanned(scene.environment_mesh, noise=0.0)
    rounded = trimesh.Trimesh(np.round(rounded.vertices, 5), rounded.faces, process=False)
    found = understood(scene, environment=rounded)
    assert found.surface_noise == 0.0
    assert np.abs(found.T_world_object - scene.T_world_object).max() < 2e-5
    assert abs(found.motion @ found.supports[0].normal) < 1e-6


def test_a_given_noise_overrides_the_measured_one_and_a_clearance_is_kept() -> None:
    scan = as_scanned(clean().environment_mesh, noise=0.0005)
    found = understood(clean(), environment=scan, surface_noise=0.001, clearance=0.003)
    assert (found.surface_noise, found.clearance) == (0.001, 0.003)
    assert understood(clean(), clearance=0.002).clearance == 0.002


@pytest.mark.parametrize("height", [-0.003, 0.003])
def test_an_object_off_its_support_is_settled_and_that_is_said(height: float) -> None:
    scene = clean()
    pose = scene.T_world_object.copy()
    pose[2, 3] += height
    found = understood(scene, object_pose=pose)
    assert np.abs(found.T_world_object - scene.T_world_object).max() < 1e-5
    assert found.parameters["settled_mm"] == pytest.approx(-1e3 * height, abs=0.01)
    assert any(f"{1e3 * abs(height):.1f} mm" in note for note in found.notes)


def test_without_settling_a_floating_object_is_refused() -> None:
    pose = clean().T_world_object.copy()
    pose[2, 3] += 0.003
    with pytest.raises(dn.errors.SceneError, match=r"touches nothing: the nearest surface is 3.0 mm below"):
        understood(clean(), object_pose=pose, settle="off")


def test_an_object_that_floats_high_is_refused_and_keeps_its_pose() -> None:
    pose = clean("table").T_world_object.copy()
    pose[2, 3] += 0.02
    with pytest.raises(dn.errors.SceneError, match=r"touches nothing: the nearest surface is 20.0 mm below"):
        understood(clean("table"), object_pose=pose)


def test_an_object_pressed_into_a_wall_is_not_pushed_out() -> None:
    pose = clean("table").T_world_object.copy()
    body = clean("table").object_in_world()
    low, high = body.bounds
    wall = trimesh.creation.box(bounds=[[high[0] - 0.003, low[1], 0.0], [high[0] + 0.02, high[1], 0.1]])
    world = trimesh.util.concatenate([clean("table").environment_mesh, wall])
    with pytest.raises(dn.errors.SceneError, match="penetrates the object by 3"):
        understood(clean("table"), environment=world, object_pose=pose)


def test_a_motion_is_turned_into_its_support_unless_it_is_meant_to_leave_it() -> None:
    scene = clean("table")
    down = scene.motion + np.array([0.0, 0.0, -0.03])
    assert understood(scene, motion=down).motion == pytest.approx(scene.motion, abs=1e-9)
    lift = scene.motion + np.array([0.0, 0.0, 1.0])
    assert understood(scene, motion=lift).motion == pytest.approx(lift / np.linalg.norm(lift))


def test_an_object_over_an_edge_rests_on_two_levels() -> None:
    """A box across a step, half on each of two boards: it comes to lie on both edges, tilted."""
    board = trimesh.creation.box(bounds=[[-0.2, -0.2, -0.02], [0.0, 0.2, 0.0]])
    lower = trimesh.creation.box(bounds=[[0.01, -0.2, -0.024], [0.2, 0.2, -0.002]])
    box = trimesh.creation.box([0.2, 0.06, 0.01])
    pose = np.eye(4)
    pose[:3, 3] = 0.03, 0.0, 0.006
    found = Scene.from_files(
        box, environment=trimesh.util.concatenate([board, lower]), object_pose=pose, motion=[1, 0, 0]
    )
    corner = found.object_in_world().vertices
    assert corner[:, 2].min() == pytest.approx(-0.002, abs=1e-5)
    assert found.parameters["settled_deg"] == pytest.approx(np.degrees(np.arctan(0.002 / 0.13)), abs=0.02)


def test_saved_and_read_back_it_is_the_same_scene(tmp_path: object) -> None:
    scan = as_scanned(clean().environment_mesh, noise=0.001)
    found = understood(clean(), environment=scan)
    found.save(str(tmp_path))
    again = dn.load_scene(str(tmp_path))
    assert (again.surface_noise, again.clearance) == (found.surface_noise, found.clearance)
    assert again.supports[0].normal == pytest.approx(found.supports[0].normal, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"settle": "on"}, "`settle` is 'on'"),
        ({"surface_noise": -0.001}, "`surface_noise` is -0.001 m; expected 0 to 0.005"),
        ({"surface_noise": float("nan")}, "`surface_noise` is nan"),
        ({"clearance": -0.001}, "`clearance` is -0.001"),
    ],
)
def test_numbers_out_of_their_domain_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(dn.errors.SceneError, match=message):
        understood(clean(), **changes)


def test_a_lip_in_the_noise_stays_a_lip() -> None:
    """4 mm high, at noise of 1 mm: too high for the sweep, whose vertices might each be noise."""
    table = trimesh.creation.box(bounds=[[-0.2, -0.15, -0.02], [0.3, 0.15, 0.0]])
    lip = trimesh.creation.box(bounds=[[0.12, -0.15, -0.01], [0.18, 0.15, 0.004]])
    pose = np.eye(4)
    pose[2, 3] = 0.005
    box = trimesh.creation.box([0.15, 0.07, 0.01])
    lip_scan = as_scanned(lip, noise=0.001)
    scan = trimesh.util.concatenate([as_scanned(table, noise=0.001), lip_scan])
    found = Scene.from_files(box, environment=scan, object_pose=pose, motion=[1, 0, 0], validate=False)
    top = found.environment_mesh.vertices
    own = top[-len(lip_scan.vertices) :]
    middle = (np.abs(own[:, 0] - 0.15) < 0.02) & (np.abs(own[:, 1]) < 0.1) & (lip_scan.vertices[:, 2] > 0)
    assert own[middle, 2].mean() == pytest.approx(0.004, abs=0.0004)
    flat = (np.abs(top[:, 0]) < 0.08) & (np.abs(top[:, 1]) < 0.1) & (top[:, 2] > -0.01)
    assert np.abs(found.supports[0].height(top[flat])).max() < 1e-9


@pytest.mark.parametrize("height", [0.003, 0.005])
def test_a_step_under_the_object_stays_a_step(height: float) -> None:
    """Noise of 0.5 mm; the object lies across the step, and its true pose is given."""
    floor = trimesh.creation.box(bounds=[[-0.15, -0.12, -0.02], [0.15, 0.12, 0.0]])
    step = trimesh.creation.box(bounds=[[0.03, -0.12, -0.01], [0.15, 0.12, height]])
    box = trimesh.creation.box([0.15, 0.07, 0.01])
    pose = np.eye(4)
    pose[2, 3] = 0.005 + height / 2
    world = trimesh.boolean.union([floor, step], engine="manifold")
    true = Scene.from_files(box, environment=world, object_pose=pose, motion=[0, 1, 0])
    scan = as_scanned(world, noise=0.0005)
    found = Scene.from_files(box, environment=scan, object_pose=true.T_world_object, motion=[0, 1, 0], validate=False)
    off = (found.object_in_world().vertices - true.object_in_world().vertices)[:, 2]
    assert np.abs(off).max() < 0.0005


def test_a_clean_lip_stays_whatever_noise_is_given() -> None:
    table = trimesh.creation.box(bounds=[[-0.2, -0.15, -0.02], [0.3, 0.15, 0.0]])
    lip = trimesh.creation.box(bounds=[[0.12, -0.15, -0.01], [0.15, 0.15, 0.008]])
    world = trimesh.util.concatenate([table, lip])
    pose = np.eye(4)
    pose[2, 3] = 0.005
    box = trimesh.creation.box([0.15, 0.07, 0.01])
    found = Scene.from_files(box, environment=world, object_pose=pose, motion=[1, 0, 0], surface_noise=0.003)
    assert [finding.what for finding in found.findings() if finding.level == "error"] == ["free_way"]


def test_an_object_within_the_upper_of_two_layers_is_raised_onto_it() -> None:
    upper = trimesh.creation.box(bounds=[[-0.15, -0.1, -0.002], [0.15, 0.1, 0.0]])
    lower = trimesh.creation.box(bounds=[[-0.15, -0.1, -0.012], [0.15, 0.1, -0.005]])
    pose = np.eye(4)
    pose[2, 3] = 0.004
    found = Scene.from_files(
        trimesh.creation.box([0.15, 0.07, 0.01]),
        environment=trimesh.util.concatenate([upper, lower]),
        object_pose=pose,
        motion=[1, 0, 0],
    )
    assert found.T_world_object[2, 3] == pytest.approx(0.005, abs=1e-6)


def test_a_lying_cylinder_comes_down_onto_its_line() -> None:
    table = trimesh.creation.box(bounds=[[-0.2, -0.2, -0.02], [0.2, 0.2, 0.0]])
    cylinder = trimesh.creation.cylinder(radius=0.015, height=0.12, sections=32)
    cylinder.apply_transform(rotation_matrix(np.pi / 2, [0, 1, 0]))
    pose = rotation_matrix(np.radians(1.0), [0, 1, 0])
    pose[2, 3] = 0.017
    found = Scene.from_files(cylinder, environment=table, object_pose=pose, motion=[0, 1, 0])
    assert np.abs(found.T_world_object[:3, :3] @ [1, 0, 0]).argmax() == 0
    assert abs(found.T_world_object[2, 0]) < 1e-4
    assert found.object_in_world().bounds[0, 2] == pytest.approx(0.0, abs=1e-5)


def test_a_given_noise_below_the_measured_one_is_contradicted() -> None:
    found = understood(clean(), environment=as_scanned(clean().environment_mesh, noise=0.001), surface_noise=0.0)
    assert any("`surface_noise` is 0 mm, but" in note for note in found.notes)


def test_hands_keep_at_least_the_noise() -> None:
    noisy = replace(clean(), surface_noise=0.001, clearance=0.0001)
    assert noisy.clearance == 0.001
    with pytest.raises(dn.errors.SceneError, match=r"`clearance` is 0\.5 m; expected 0 to 0\.05"):
        replace(clean(), clearance=0.5)


def test_vertices_that_a_file_repeats_are_one_surface() -> None:
    scan = as_scanned(clean().environment_mesh, noise=0.001)
    soup = trimesh.Trimesh(scan.triangles.reshape(-1, 3), np.arange(3 * len(scan.faces)).reshape(-1, 3), process=False)
    found = understood(clean(), environment=soup)
    assert found.supports[0].tilt < 0.06
    under = np.abs(found.supports[0].height(found.environment_mesh.vertices)) < 0.003
    around = np.abs(found.environment_mesh.vertices - clean().T_world_object[:3, 3]).max(axis=1) < 0.05
    assert np.abs(found.supports[0].height(found.environment_mesh.vertices[under & around])).max() < 1e-9


def test_draws_verified_in_a_scan_hold_in_the_true_world(shadow_hand) -> None:
    """Noise of 1 mm, a pose that is off by 2 mm and 1 degree."""
    true = clean("shelf")
    pose = turned(true, 1.0)
    pose[:3, 3] += 0.002 / np.sqrt(3)
    scan = understood(true, environment=as_scanned(true.environment_mesh, noise=0.001), object_pose=pose)
    samples = dn.Sampler(shadow_hand).sample(scan, num=16, seed=0)
    assert samples.success.sum() >= 12
    judged = dn.verify(true, shadow_hand, samples.q)
    assert judged.success[:3].all()  # the best first
    assert (judged.success & samples.success).sum() >= 9


@pytest.mark.parametrize("depth", [0.003, 0.004])
def test_flanks_of_bumps_hold_nothing_from_beside(depth: float) -> None:
    """An object whose pose stands millimetres in a rough board meets the flanks of its bumps with its sides."""
    scene = clean()
    pose = turned(scene, 2.0)
    pose[2, 3] -= depth
    found = understood(scene, environment=as_scanned(scene.environment_mesh, noise=0.002), object_pose=pose)
    assert [support.side for support in found.supports] == ["below"]
    assert not any("beside" in note for note in found.notes)
    up = found.T_world_object[:3, :3] @ scene.T_world_object[:3, :3].T @ [0.0, 0.0, 1.0]
    assert np.linalg.norm(np.cross(up, found.supports[0].normal)) < 1e-3  # flat on the plane that carries it
