"""Surroundings by their surface: the pieces are where it is on its free side, and an object slides on them as on a box."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from dexnudge.scenes.boxes import box
from dexnudge.scenes.scene import Scene
from dexnudge.simulation import convex_pieces
from dexnudge.simulation.model import scene_model
from dexnudge.simulation.surface_pieces import DEPTH, FLATNESS, MOST_OUT, surface_pieces

WAY = np.array([[-0.08, -0.04, 0.0], [0.18, 0.04, 0.012]])
TABLE = box((-0.4, -0.3, -0.03), (0.4, 0.3, 0.0))


def top_of(table: trimesh.Trimesh) -> trimesh.Trimesh:
    table = table.copy()
    table.update_faces(table.face_normals[:, 2] > 0.5)
    return table


def scan_of_the_top(noise: float) -> trimesh.Trimesh:
    """Fine triangles with holes, exact where the object slides and noisy elsewhere."""
    generator = np.random.default_rng(0)
    scan = top_of(TABLE).subdivide_to_size(0.02)
    scan.merge_vertices()
    far = (np.abs(scan.vertices - np.clip(scan.vertices, *WAY)) > 0.03).any(axis=1)
    scan.vertices[far, 2] += generator.normal(0, noise, np.count_nonzero(far))
    scan.update_faces(generator.random(len(scan.faces)) > 0.01)
    return scan


def height_of(pieces: list[np.ndarray], places: np.ndarray) -> np.ndarray:
    """Return the height of the uppermost piece at (x, y)."""
    top = np.full(len(places), -np.inf)
    for piece in pieces:
        equations = ConvexHull(piece).equations
        low, high = np.full(len(places), -1.0), np.full(len(places), 1.0)
        for a, b, c, d in equations:
            rest = -(a * places[:, 0] + b * places[:, 1] + d)
            if c > 1e-9:
                high = np.minimum(high, rest / c)
            elif c < -1e-9:
                low = np.maximum(low, rest / c)
            else:
                high = np.where(rest < -1e-9, -np.inf, high)
        top = np.where(high >= low, np.maximum(top, high), top)
    return top


def places(count: int = 300) -> np.ndarray:
    return np.random.default_rng(1).uniform(WAY[0, :2] - 0.1, WAY[1, :2] + 0.1, (count, 2))


@pytest.mark.parametrize("split", [False, True])
def test_a_sheet_is_one_piece_below_it(split):
    sheet = top_of(TABLE.subdivide_to_size(0.1) if split else TABLE)
    (piece,) = surface_pieces(sheet, WAY).pieces
    np.testing.assert_allclose(np.ptp(piece, axis=0), [0.8, 0.6, DEPTH], atol=1e-9)
    assert piece[:, 2].max() == pytest.approx(0.0, abs=1e-9)


def test_a_sheet_that_faces_down_reaches_up():
    lid = top_of(TABLE)
    lid.faces = lid.faces[:, ::-1]
    (piece,) = surface_pieces(lid, WAY).pieces
    assert (piece[:, 2].min(), piece[:, 2].max()) == pytest.approx((0.0, DEPTH))


def test_a_thin_board_is_not_left_on_its_other_side():
    angle = np.array([[0.0, 0], [0.3, 0], [0.3, 0.002], [0.002, 0.002], [0.002, 0.2], [0, 0.2]])
    board = trimesh.creation.extrude_polygon(trimesh.path.polygons.Polygon(angle), 0.2)
    corners = np.concatenate(surface_pieces(board, board.bounds).pieces)
    distance = trimesh.proximity.ProximityQuery(board).signed_distance(corners)
    assert distance.min() > -1e-4


def test_a_scan_with_holes_is_where_its_triangles_are():
    scan = scan_of_the_top(noise=2e-4)
    found = surface_pieces(scan, WAY)
    assert found.error <= 5e-4
    assert len(found.pieces) < len(scan.faces) / 2
    np.testing.assert_allclose(height_of(found.pieces, places()), 0.0, atol=1e-3)
    # What the object slides on is one piece.
    inner = np.array([[x, y] for x in (-0.07, 0.17) for y in (-0.03, 0.03)])
    assert any((height_of([piece], inner) > -FLATNESS).all() for piece in found.pieces)


def test_the_number_of_pieces_has_a_limit_and_the_error_is_told():
    rough = top_of(TABLE).subdivide_to_size(0.012)
    rough.merge_vertices()
    rough.vertices[:, 2] += np.random.default_rng(0).normal(0, 0.003, len(rough.vertices))
    found = surface_pieces(rough, WAY, most=600)
    assert len(found.pieces) <= 600
    assert found.error > 5e-4


def tunnel() -> trimesh.Trimesh:
    """A closed body with an inner floor at z = 0 and a lid 80 mm above it: far from convex."""
    outer, inner = (
        [[-0.2, -0.02], [0.2, -0.02], [0.2, 0.1], [-0.2, 0.1]],
        [[-0.18, 0], [0.18, 0], [0.18, 0.08], [-0.18, 0.08]],
    )
    body = trimesh.creation.extrude_polygon(trimesh.path.polygons.Polygon(outer, [inner]), 0.6)
    body.apply_transform(np.array([[0.0, 0, 1, -0.3], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]))
    return body


SURROUNDINGS = {
    "sheet": top_of(TABLE),
    "fine triangles": TABLE.subdivide_to_size(0.05),
    "scan with holes": scan_of_the_top(noise=2e-4),
    "tunnel": tunnel(),
}


@pytest.fixture(scope="module")
def slid(pad_hand, block):
    """Where the block comes to rest when it is set going on surroundings, the hand far away [m]."""

    def slide(environment: trimesh.Trimesh) -> np.ndarray:
        pose = np.eye(4)
        pose[2, 3] = -block.bounds[0, 2]
        scene = Scene(block, environment, pose, np.array([1.0, 0, 0]), friction_environment=0.2)
        simulation = scene_model(pad_hand, replace(scene, mass=0.2))
        q = np.zeros(9 + pad_hand.num_joints)
        q[:9] = 0, 0, 2.0, 1, 0, 0, 0, 1, 0
        simulation.place(q)
        free = simulation.object_position
        speed = simulation.model.jnt_dofadr[simulation.model.body_jntadr[simulation.object_body]]
        simulation.data.qvel[speed] = 0.6
        for _ in range(500):
            mujoco.mj_step(simulation.model, simulation.data)
        return np.array(simulation.data.qpos[free : free + 3]) - pose[:3, 3]

    return slide


@pytest.mark.parametrize("name", SURROUNDINGS)
def test_an_object_slides_as_far_as_on_a_box(name, slid, monkeypatch):
    monkeypatch.setattr(convex_pieces, "MOST_FACES_CUT", 0)
    expected, found = slid(TABLE), slid(SURROUNDINGS[name])
    assert expected[0] == pytest.approx(0.6**2 / (2 * 0.2 * 9.81), rel=0.1)
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_pieces_of_a_rough_solid_leave_the_room_beside_it_free():
    rough = TABLE.subdivide_to_size(0.012)
    rough.merge_vertices()
    rough.vertices[:, 2] += np.random.default_rng(0).normal(0, 0.003, len(rough.vertices))
    found = surface_pieces(rough, WAY, most=600)
    assert 100 < len(found.pieces) <= 600
    assert found.error > 5e-4
    weights = np.random.default_rng(1).dirichlet(np.ones(6), 50)
    points = np.concatenate([weights @ piece for piece in found.pieces if len(piece) == 6])
    out = -trimesh.proximity.ProximityQuery(rough).signed_distance(points)
    assert np.quantile(out, 0.99) < MOST_OUT
