"""What a user has, a mesh of the world as it was measured and a pose that is a little off, made into a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import ConvexHull

from dexnudge.errors import SceneError, quote
from dexnudge.geometry.exact_distance import Rays
from dexnudge.geometry.surface_lattice import faces_near
from dexnudge.scenes.plane_fit import EXACT, MAD_TO_DEVIATION
from dexnudge.scenes.settling import DOWN, MOST_SHIFT, MOST_TURN, Settled, along_support, settle, snapped
from dexnudge.scenes.supports import Support, all_supports, facing_points

SETTLE = ("auto", "off")
LARGEST_CLEARANCE = 0.05  # [m] more leaves no room for a hand beside an object
LARGEST_NOISE = 0.005  # [m] above it a surface tells nothing about where a hand may go
SMALLEST_SHIFT, SMALLEST_TURN = 5e-5, np.radians(0.005)  # [m], [rad] less is zero in a sentence
AROUND = 0.003  # [m] above and beside the object within which a measured surface may be one that it touches


def understood(
    mesh: trimesh.Trimesh,
    environment: trimesh.Trimesh,
    T_world_object: Float[np.ndarray, "4 4"],
    motion: Float[np.ndarray, "3"],
    *,
    settle_object: str,
    surface_noise: float | None,
    clearance: float,
) -> dict[str, Any]:
    """Return the fields of a `Scene`: supports made flat, the object settled on them, the motion in their plane.

    Args:
        mesh: object [m, object frame].
        environment: surroundings as measured [m, world].
        T_world_object: as given.
        motion: as given, unit, world.
        settle_object: "off" keeps the pose.
        surface_noise: root mean square [m]; that of the supports where it is None. What is flat is always measured.
        clearance: that hands shall keep from the surroundings at least [m]; the noise where that is more.

    Clean surroundings, and an object that rests on them, come out as they went in.

    Raises:
        SceneError: an invalid noise or clearance, or another word for `settle`.
    """
    if settle_object not in SETTLE:
        raise SceneError(f"`settle` is {quote(settle_object)}; expected 'auto' or 'off'")
    check_margins(surface_noise=surface_noise or 0.0, clearance=clearance)
    body = mesh.copy().apply_transform(T_world_object)
    below = MOST_SHIFT + float(np.sin(MOST_TURN)) * 0.5 * float(np.linalg.norm(mesh.extents))
    supports = all_supports(body, environment, below=below, around=AROUND)
    if surface_noise is not None and "origin" in environment.metadata:  # assumed planes are flat, what is around is not
        supports = tuple(replace(support, noise=max(support.noise, surface_noise)) for support in supports)
    flat = snapped(environment, supports, around=body.bounds.mean(axis=0))
    settled = Settled(T_world_object, 0.0, 0.0, rests=True)
    if settle_object == "auto":
        settled = settle(mesh, flat, T_world_object, supports)
    carrying = [support for support in supports if support.side == "below"]
    along = along_support(motion, carrying[0]) if carrying else motion
    measured = max((support.noise for support in supports), default=0.0)
    noise = surface_noise if surface_noise is not None else measured if measured > EXACT else 0.0
    notes = []
    if surface_noise is not None and surface_noise < 0.5 * measured:
        notes.append(
            f"`surface_noise` is {1e3 * surface_noise:.2g} mm, but what carries or holds the object scatters by "
            f"{1e3 * measured:.2g} mm"
        )
    notes += _notes(supports, environment, flat, settled, motion, along)
    if notes:
        flat = flat if flat is not environment else environment.copy()
        flat.metadata["notes"] = [*environment.metadata.get("notes", ()), *notes]
    parameters: dict[str, Any] = {}
    if settled.shift or settled.turn:
        parameters |= {
            "T_world_object_given": T_world_object,
            "settled_mm": round(1e3 * settled.shift, 3),
            "settled_deg": round(float(np.degrees(settled.turn)), 3),
        }
    if along is not motion:
        parameters["motion_given"] = motion
    return {
        "object_mesh": mesh,
        "environment_mesh": flat,
        "T_world_object": settled.T_world_object,
        "motion": along,
        "surface_noise": noise,
        "clearance": clearance,
        "parameters": parameters,
    }


def check_margins(*, surface_noise: float, clearance: float) -> None:
    """Refuse a noise or a clearance [m] that leaves no room for a hand, or is none; SceneError."""
    for name, value, largest in (
        ("surface_noise", surface_noise, LARGEST_NOISE),
        ("clearance", clearance, LARGEST_CLEARANCE),
    ):
        if not 0 <= value <= largest:
            raise SceneError(f"`{name}` is {value:g} m; expected 0 to {largest:g} m")


def _notes(
    supports: Sequence[Support],
    measured: trimesh.Trimesh,
    flat: trimesh.Trimesh,
    settled: Settled,
    motion: Float[np.ndarray, "3"],
    along: Float[np.ndarray, "3"],
) -> list[str]:
    """Return what was done, a sentence each."""
    notes = []
    if flat is not measured:
        notes += [
            f"the surface {support.side} the object scatters by {1e3 * support.noise:.2f} mm about a plane that leans by "
            f"{support.tilt:.2f} deg; it counts as that plane"
            for support in supports
        ]
    if settled.shift or settled.turn:
        way = "raised" if settled.shift > 0 else "lowered"
        did = [f"{way} by {1e3 * abs(settled.shift):.1f} mm"] if abs(settled.shift) >= SMALLEST_SHIFT else []
        did += [f"tilted by {np.degrees(settled.turn):.2f} deg"] if settled.turn >= SMALLEST_TURN else []
        moved = " and ".join(did) or f"moved by less than {1e3 * SMALLEST_SHIFT:g} mm"
        notes.append(f"the object was {moved} to rest on its supports (`settle` off keeps its pose)")
    if not settled.rests and any(support.side == "below" for support in supports):
        notes.append("the object does not come to rest within 5 mm and 3 deg of its pose: it may tip")
    if along is not motion:
        angle = float(np.arccos(np.clip(motion @ along, -1.0, 1.0)))
        if angle >= SMALLEST_TURN:
            notes.append(f"the motion was turned by {np.degrees(angle):.2f} deg into the plane of the support")
    return notes


DEPTH = 0.3  # [m] below the object in which there is nothing
RING = 0.05  # [m] around its footprint in which there is a surface
LEVEL = 0.02  # [m] from its lowest point, within which that surface lies
UPWARD = 0.5  # z of the normal of a surface that can carry
LEAST_VERTICES = 12  # of the surface around it
MOST_NOISE = 2e-3  # [m] of that surface about its plane
BEYOND = 0.005  # [m] by which the patch is wider than the footprint


def without_hole_below(environment: trimesh.Trimesh, body: trimesh.Trimesh) -> tuple[trimesh.Trimesh, float | None]:
    """Return surroundings [m, world] with a patch where nothing is below a body [m, world] and a plane is all around it.

    And the noise of that plane [m]; None where there is no patch, or the plane is exact.

    Nothing within 0.3 m under any point of the body, and upward surfaces on its four sides that scatter by at most 2 mm
    about one plane. All others are returned as they are.
    """
    height = float(body.extents[2])
    column = faces_near(environment, body.bounds + np.array([[-RING, -RING, -DEPTH], [RING, RING, 0.0]]))
    if len(column) == 0 or "origin" in environment.metadata:  # depth images have their planes continued already
        return environment, None
    near = trimesh.Trimesh(environment.vertices, environment.faces[column], process=False)
    points = facing_points(body, DOWN)
    if (Rays(near).first_hits(points - height * DOWN, DOWN[None], reach=DEPTH + height)[1] >= 0).any():
        return environment, None
    ring = np.asarray(near.vertices)[np.unique(near.faces[np.asarray(near.face_normals)[:, 2] > UPWARD])]
    (low, high), lowest = body.bounds[:, :2], float(body.bounds[0, 2])
    within = (np.abs(ring[:, :2] - (low + high) / 2) <= (high - low) / 2 + RING).all(axis=1)
    ring = ring[within & (np.abs(ring[:, 2] - lowest) <= LEVEL)]
    sides = [ring[:, 0] < low[0], ring[:, 0] > high[0], ring[:, 1] < low[1], ring[:, 1] > high[1]]
    if len(ring) < LEAST_VERTICES or not all(side.any() for side in sides):
        return environment, None
    plane = np.linalg.lstsq(_affine(ring), ring[:, 2], rcond=None)[0]
    noise = MAD_TO_DEVIATION * float(np.median(np.abs(_affine(ring) @ plane - ring[:, 2])))
    if noise > MOST_NOISE:
        return environment, None
    outline = points[ConvexHull(points[:, :2]).vertices]
    outward = outline - outline.mean(axis=0)
    outline = outline + BEYOND * outward / np.linalg.norm(outward, axis=1, keepdims=True)
    outline[:, 2] = _affine(outline) @ plane
    fan = [[0, index, index + 1] for index in range(1, len(outline) - 1)]  # counter-clockwise: it faces up
    vertices = np.concatenate([environment.vertices, outline])
    faces = np.concatenate([environment.faces, np.array(fan) + len(environment.vertices)])
    filled = trimesh.Trimesh(vertices, faces, process=False)
    filled.metadata.update(environment.metadata)
    area = 1e4 * float(ConvexHull(outline[:, :2]).volume)
    note = (
        f"nothing was measured below the object, as where it lay during the scan: {area:.0f} cm^2 there are assumed to "
        f"go on as the plane around them, noise {1e3 * noise:.1f} mm"
    )
    filled.metadata["notes"] = [*environment.metadata.get("notes", ()), note]
    return filled, noise if noise > EXACT else None


def _affine(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return np.column_stack([points[:, :2], np.ones(len(points))])
