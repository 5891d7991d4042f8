"""What is to be seen of a hand alone, and its page: links coloured by digit, and an arrow where the palm faces."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.geometry.exact_distance import Rays
from dexnudge.hands.closing import closing
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import visual_meshes
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.viewer.camera import framing_camera
from dexnudge.viewer.page import write_template
from dexnudge.viewer.page_data import ASPECT, page_data
from dexnudge.viewer.visual_scene import Colour, Part, Role, VisualScene

DIGIT_COLOURS: tuple[Colour, ...] = (  # told apart by the colour-blind too; none is the arrow's red
    (0.00, 0.45, 0.70),
    (0.90, 0.47, 0.05),
    (0.00, 0.62, 0.45),
    (0.62, 0.35, 0.71),
    (0.93, 0.82, 0.10),
    (0.45, 0.27, 0.17),
    (0.34, 0.71, 0.91),
    (0.90, 0.47, 0.76),
)
PALM_COLOUR: Colour = (0.87, 0.84, 0.79)
BASE_COLOUR: Colour = (0.55, 0.57, 0.60)
ARROW_COLOUR: Colour = (0.82, 0.08, 0.16)
TINT = 0.55  # of white in the links of a digit that are not its tip

SIZE = 0.2  # [m] of the hand without its base as it is shown, where light and shadows look best; hands are of any size
ARROW_LENGTH, ARROW_RADIUS, HEAD_LENGTH, HEAD_RADIUS = 0.085, 0.004, 0.028, 0.010  # [m] at that size
FACE_RAYS = 24  # on a side of the grid that looks for the palm's face
ALONG = 0.35  # sine of the angle between fingers and palm normal below which the fingers point where the palm faces


def hand_views(hand: Hand, poses: Sequence[Float[np.ndarray, " joint"]]) -> list[VisualScene]:
    """Return what is to be seen of a hand at each of some joint angles; the views share their meshes.

    Its fingers point along z and its palm faces along x. Where the fingers point to where the palm faces, as those of a
    gripper do, or the other way, both are along z, and digits stand side by side along y. All views are `shown_scale`
    times as large as the hand.

    poses: joint angles [rad].
    """
    T_palm_links = _link_poses(hand, poses)
    T_view_palm = palm_in_view(hand)
    roles, colours = zip(*(_look(hand, name) for name in hand.link_names), strict=True)
    arrow = Part("palm faces", "arrow", _arrow(hand), np.eye(4), ARROW_COLOUR)
    views = []
    for T_palm_link in T_palm_links:
        links = map(Part, hand.link_names, roles, visual_meshes(hand), T_view_palm @ T_palm_link, colours)
        parts = (*(part for part in links if len(part.mesh.faces)), arrow)
        views.append(VisualScene(parts, np.zeros((0, 3)), np.zeros(3)))
    return views


@cached_per_instance
def shown_scale(hand: Hand) -> float:
    """Return how much larger than it is a hand is shown; its base does not count."""
    (transforms,) = _link_poses(hand, [_zero(hand)])
    placed = [
        trimesh.transform_points(mesh.vertices, pose)
        for name, mesh, pose in zip(hand.link_names, hand.link_meshes, transforms, strict=True)
        if name != hand.base_link
    ]
    return SIZE / float(np.ptp(np.concatenate(placed) @ _axes(hand).T, axis=0).max())


def palm_in_view(hand: Hand) -> Float[np.ndarray, "4 4"]:
    """Return the pose of the palm's frame in the view, which includes the scale."""
    T_view_palm = np.eye(4)
    T_view_palm[:3, :3] = shown_scale(hand) * _axes(hand)
    return T_view_palm


def hand_summary(hand: Hand) -> str:
    """Return how many joints and digits it has, and what the colours of a digit mean."""
    joints = f"{hand.num_joints} joint{'' if hand.num_joints == 1 else 's'}"
    return f"{joints}, {len(hand.fingertips)} digits; tips, which make contact, in full colour"


def hand_legend(hand: Hand) -> dict[str, Colour]:
    """Return what is shown, and its colour."""
    base = {} if hand.base_link is None else {f"base: {hand.base_link}": BASE_COLOUR}
    normal = ", ".join(f"{each:.3g}" for each in hand.palm_normal)
    ends = {f"palm: {hand.link_names[0]}": PALM_COLOUR, **base, f"where the palm faces: ({normal})": ARROW_COLOUR}
    return digit_colours(hand) | ends


def digit_colours(hand: Hand) -> dict[str, Colour]:
    """Return the colour of each digit's tip; they repeat from the ninth digit on."""
    return {digit: DIGIT_COLOURS[index % len(DIGIT_COLOURS)] for index, digit in enumerate(hand.fingertips)}


def _zero(hand: Hand) -> Float[np.ndarray, " joint"]:
    return np.clip(np.zeros(hand.num_joints), hand.lower, hand.upper)


def _link_poses(hand: Hand, poses: Sequence[Float[np.ndarray, " joint"]]) -> Float[np.ndarray, "pose link 4 4"]:
    return hand.forward_kinematics(hand.at_origin(np.stack(poses))).numpy()


def _look(hand: Hand, link: str) -> tuple[Role, Colour]:
    digit = hand.digit_of_link[link]
    if link == hand.base_link:
        return "base", BASE_COLOUR
    if digit is None:
        return "link", PALM_COLOUR
    full = digit_colours(hand)[digit]
    if link in hand.fingertip_links:
        return "fingertip", full
    red, green, blue = (channel + TINT * (1 - channel) for channel in full)
    return "link", (red, green, blue)


def _normal(hand: Hand) -> Float[np.ndarray, "3"]:
    return hand.palm_normal / np.linalg.norm(hand.palm_normal)


@cached_per_instance
def _axes(hand: Hand) -> Float[np.ndarray, "3 3"]:
    """Return the rotation from the palm's frame to that of the view."""
    normal = _normal(hand)
    tips = hand.keypoints(hand.at_origin(_zero(hand)[None]))[0].numpy()
    fingers = tips if len(tips) < 3 else np.delete(tips, hand.thumb, axis=0)
    way = fingers.mean(axis=0) - _palm_face(hand)
    if np.linalg.norm(np.cross(way, normal)) > ALONG * np.linalg.norm(way):
        return np.stack([normal, np.cross(hand.finger_axis, normal), hand.finger_axis])
    # At mid-range even jaws are apart; their middles show in which direction.
    (poses,) = _link_poses(hand, [(hand.lower + hand.upper) / 2])
    places = [
        trimesh.transform_points([hand.link_meshes[tip].centroid], poses[tip])[0] for tip in hand.fingertip_indices
    ]
    apart = np.asarray(places) - np.mean(places, axis=0)
    apart -= np.outer(apart @ normal, normal)
    across = np.linalg.svd(apart)[2][0]
    across *= np.sign(apart[0] @ across) or 1.0
    up = normal if way @ normal > 0 else -normal
    return np.stack([np.cross(across, up), across, up])


def _arrow(hand: Hand) -> trimesh.Trimesh:
    """Return the arrow in the frame of the view, of which the palm's origin is the origin too."""
    shaft = trimesh.creation.cylinder(ARROW_RADIUS, segment=[[0, 0, 0], [0, 0, ARROW_LENGTH - HEAD_LENGTH]])
    head = trimesh.creation.cone(HEAD_RADIUS, HEAD_LENGTH)
    head.apply_translation([0, 0, ARROW_LENGTH - HEAD_LENGTH])
    rotation = _axes(hand)
    pose = trimesh.geometry.align_vectors([0, 0, 1], rotation @ _normal(hand))
    pose[:3, 3] = shown_scale(hand) * rotation @ _palm_face(hand)
    return trimesh.util.concatenate([shaft, head]).apply_transform(pose)


@cached_per_instance
def _palm_face(hand: Hand) -> Float[np.ndarray, "3"]:
    """Return the middle of what is seen of the palm by one who looks at its face [m], palm frame.

    Of a palm without geometry, of the base or of all links.
    """
    (transforms,) = _link_poses(hand, [_zero(hand)])
    corners = [
        trimesh.transform_points(mesh.vertices, pose)[mesh.faces]
        for mesh, pose in zip(hand.link_meshes, transforms, strict=True)
    ]
    base = [] if hand.base_link is None else [corners[hand.link_names.index(hand.base_link)]]
    seen = next(each for each in (corners[0], *base, np.concatenate(corners)) if len(each))
    normal = _normal(hand)
    points = seen.reshape(-1, 3)
    across = trimesh.geometry.align_vectors([0, 0, 1], normal)[:3, :2]
    low, high = (points @ across).min(axis=0), (points @ across).max(axis=0)
    share = (np.arange(FACE_RAYS) + 0.5) / FACE_RAYS
    grid = np.stack(np.meshgrid(*(low + share[:, None] * (high - low)).T), axis=-1).reshape(-1, 2)
    size = np.ptp(points, axis=0).max()
    starts = grid @ across.T + (float((points @ normal).max()) + size) * normal
    solid = trimesh.Trimesh(points, np.arange(len(points)).reshape(-1, 3), process=False)
    depth, face = Rays(solid).first_hits(starts, -normal[None], reach=float(3 * size))
    hits = (starts - depth[:, None] * normal)[face >= 0]
    if not len(hits):
        return points.mean(axis=0)
    return hits[np.linalg.norm((hits - hits.mean(axis=0)) @ across, axis=1).argmin()]


AZIMUTH, ELEVATION = np.radians(35.0), np.radians(18.0)  # of the first view, onto the palm's face from aside


def write_hand_page(hand: Hand, path: Path | str) -> Path:
    """Write the page: a 3-D view, a slider for each joint, and buttons for the rest, open and closed pose.

    Raises:
        OutputError: the file cannot be written.
    """
    found = closing(hand)
    poses = {"rest": found.rest, "open": found.open, "closed": found.closed}
    buttons = "".join(f'<button type="button">{name}</button>' for name in poses)
    sliders = "\n".join(
        f'<label class="control"><span>{escape(name)}</span>'
        f'<input type="range" min="{lower:.6g}" max="{upper:.6g}" step="any"><output></output></label>'
        for name, lower, upper in zip(hand.joint_names, hand.lower, hand.upper, strict=True)
    )
    return write_template(
        path,
        "hand",
        _hand_data(hand, poses),
        hand_legend(hand),
        title=escape(hand.name),
        subtitle=hand_summary(hand),
        buttons=buttons,
        sliders=sliders,
    )


def _hand_data(hand: Hand, poses: dict[str, Float[np.ndarray, " joint"]]) -> dict[str, Any]:
    """Return what `page_data` has of the hand, with its tree and what its joints do; see `Joint`.

    root: pose of the palm's frame in the view (3 x 4, row by row); body_links: of each body the link that carries it,
    null for the arrow.
    """
    views = hand_views(hand, list(poses.values()))
    seen = np.concatenate([view.vertices("link", "fingertip", "arrow") for view in views])
    camera = framing_camera(seen, azimuth=AZIMUTH, elevation=ELEVATION, aspect=ASPECT)
    names = {name: index for index, name in enumerate(hand.link_names)}
    links: list[dict[str, Any]] = [{"parent": -1}]
    for parent, joint in zip(hand.link_parent[1:].tolist(), hand.joints[1:], strict=True):
        assert joint is not None
        links.append(
            {
                "parent": parent,
                "origin": joint.origin[:3].reshape(-1).tolist(),
                "axis": joint.axis.tolist(),
                "slides": joint.slides,
                "index": joint.index,
                "multiplier": joint.multiplier,
                "offset": joint.offset,
            }
        )
    return {
        **page_data(views[:1], camera=camera),
        "root": palm_in_view(hand)[:3].reshape(-1).tolist(),
        "links": links,
        "body_links": [names.get(part.name) if part.role != "arrow" else None for part in views[0].parts],
        "joints": [{"slides": bool(slides)} for slides in hand.sliding],
        "couplings": hand.coupled_indices.tolist(),
        "poses": [{"name": name, "angles": angles.tolist()} for name, angles in poses.items()],
    }
