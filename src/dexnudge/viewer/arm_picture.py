"""An arm, with a hand or without, in one picture: at home, from two sides, with the axes of its base and its flange."""

import numpy as np
import trimesh
from jaxtyping import Float, UInt8

from dexnudge.arms.arm import Arm
from dexnudge.arms.robot import Robot
from dexnudge.hands.link_meshes import visual_meshes
from dexnudge.viewer.camera import framing_camera
from dexnudge.viewer.hand_view import BASE_COLOUR, PALM_COLOUR, digit_colours
from dexnudge.viewer.picture import arrange, render_array
from dexnudge.viewer.visual_scene import Colour, Part, VisualScene

TILE = (720, 760)  # pixels of each picture, width and height
SIZE = 0.35  # [m] of the robot as it is shown, where light and shadows look best
SIDES = {"front": (28.0, 18.0), "side": (-82.0, 12.0)}  # [deg] azimuth and elevation of the camera
TANGENT = 0.15  # of half the vertical angle of view
FILLED = 0.86  # of each picture by the robot
TITLE_ROOM = 0.03  # [m] above the robot, at the shown size
AXIS_LENGTH, AXIS_RADIUS = 0.04, 0.0016  # [m] at the shown size
AXES: tuple[Colour, ...] = ((0.82, 0.08, 0.16), (0.10, 0.60, 0.20), (0.12, 0.30, 0.86))  # x, y, z


def arm_picture(arm: Arm | Robot, *, tile: tuple[int, int] = TILE) -> UInt8[np.ndarray, "height width 3"]:
    """Return an arm, or a robot, at home from two sides as sRGB bytes; x, y and z of base and flange are red, green, blue.

    tile: width and height of each side in pixels.
    """
    view = VisualScene(tuple(_parts(arm)), np.zeros((0, 3)), np.zeros(3))
    points = np.concatenate([part.vertices_in_world() for part in view.parts])
    points = np.concatenate([points, points.max(axis=0)[None] + [0.0, 0.0, TITLE_ROOM]])
    pictures = []
    for azimuth, elevation in SIDES.values():
        camera = framing_camera(
            points,
            azimuth=np.radians(azimuth),
            elevation=np.radians(elevation),
            aspect=tile[0] / tile[1],
            tangent=TANGENT,
            filled=FILLED,
        )
        pictures.append(render_array(view, size=tile, camera=camera))
    name = arm.name if isinstance(arm, Arm) else f"{arm.arm.name}, {arm.hand.name}"
    return arrange(pictures, [name, "from the side"], columns=2)


def _parts(arm: Arm | Robot) -> list[Part]:
    """Return links and axes where the base stands at the origin, smaller than they are."""
    own = (arm if isinstance(arm, Arm) else arm.arm).standing_at(np.eye(4))
    poses = own.link_poses(own.home)
    placed = [
        (own.tree.links[link], pose, PALM_COLOUR if number % 2 else BASE_COLOUR)
        for number, (link, pose) in enumerate(poses.items())
    ]
    if isinstance(arm, Robot):
        first = len(own.tree.links)
        hanging = np.linalg.inv(arm.arm.T_world_base) @ arm.at_home()[first:]
        meshes = zip(arm.body.link_names[first:], visual_meshes(arm.body)[first:], hanging, strict=True)
        colours, digits = digit_colours(arm.hand), arm.hand.digit_of_link
        placed += [(mesh, pose, colours.get(digits[name] or "", PALM_COLOUR)) for name, mesh, pose in meshes]
    points = [trimesh.transform_points(mesh.vertices, pose) for mesh, pose, _ in placed if len(mesh.faces)]
    scale = SIZE / float(np.ptp(np.concatenate(points), axis=0).max())
    shrink = np.diag([scale, scale, scale, 1.0])
    parts = [Part("link", "link", mesh, shrink @ pose, colour) for mesh, pose, colour in placed if len(mesh.faces)]
    for link in (own.base, own.flange):
        pose = poses[link].copy()
        pose[:3, 3] *= scale
        parts += [Part(link, "arrow", _axis(number), pose, colour) for number, colour in enumerate(AXES)]
    return parts


def _axis(number: int) -> trimesh.Trimesh:
    end: Float[np.ndarray, " 3"] = AXIS_LENGTH * np.eye(3)[number]
    return trimesh.creation.cylinder(AXIS_RADIUS, segment=[np.zeros(3), end], sections=12)
