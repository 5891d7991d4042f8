"""Pictures of a hand, at rest, open and closed, and of an arm at home, with a hand or without; each from two sides."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import trimesh
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from dexnudge.arms.arm import Arm
from dexnudge.arms.robot import Robot
from dexnudge.hands.closing import closing
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import visual_meshes
from dexnudge.viewer.camera import Camera, framing_camera
from dexnudge.viewer.hand_view import (
    BASE_COLOUR,
    PALM_COLOUR,
    digit_colours,
    hand_legend,
    hand_summary,
    hand_views,
    shown_scale,
)
from dexnudge.viewer.picture import TITLE_COLOUR, arrange, render_array
from dexnudge.viewer.visual_scene import Colour, Part, VisualScene

TILE = (560, 600)  # pixels of each picture, width and height
TANGENT = 0.08  # of half the vertical angle of view: from so far away that one scale holds for near and far links
FILLED = 0.84  # of each picture by the hand
BASE_SHOWN = 0.3  # of the hand's size: what stands farther from the hand may leave the picture
LOWERED = 0.07  # of half a picture's height, to leave room for its title
SIDES = {"from the front": (25.0, 18.0), "from the side": (82.0, 10.0)}  # [deg] azimuth and elevation of the camera
TEXT, SMALL, MARGIN = 0.050, 0.040, 0.037  # of a tile's height: texts of heading and legend, and the room around them
BAR = 0.08  # of the picture's width, the most that the bar of the scale takes


def hand_picture(hand: Hand, *, tile: tuple[int, int] = TILE) -> UInt8[np.ndarray, "height width 3"]:
    """Return the picture as sRGB bytes: rows are two sides, columns the hand at rest, open and closed.

    Tips, which make contact, have their digit's full colour, its other links a tint of it. All six pictures have one scale.

    tile: width and height of each of the six in pixels.
    """
    way = closing(hand)
    poses = {"rest": way.rest, "open": way.open, "closed": way.closed}
    views = hand_views(hand, list(poses.values()))
    cameras = hand_cameras(views, tile)
    pictures = [render_array(view, size=tile, camera=camera) for camera in cameras.values() for view in views]
    sheet = arrange(pictures, [f"{pose}, {side}" for side in cameras for pose in poses], columns=len(poses))
    camera = next(iter(cameras.values()))
    distance = -float(camera.position @ camera.forward)
    pixels_per_metre = tile[1] / 2 / (TANGENT * distance) * shown_scale(hand)
    heading = _heading(f"{hand.name}: {hand_summary(hand)}", sheet.shape[1], tile[1])
    return np.concatenate([heading, sheet, _legend(hand, pixels_per_metre, sheet.shape[1], tile[1])])


def hand_cameras(views: Sequence[VisualScene], tile: tuple[int, int]) -> dict[str, Camera]:
    """Return one camera for each side; all stand equally far from the palm.

    They see all that any of the views shows, and of a long base as much as stands close to the rest.

    Args:
        views: as `hand_views` returns them.
        tile: width and height of a picture in pixels.
    """
    points = np.concatenate([view.vertices("link", "fingertip", "arrow") for view in views])
    around = BASE_SHOWN * np.ptp(points, axis=0).max()
    base = views[0].vertices("base").clip(points.min(axis=0) - around, points.max(axis=0) + around)
    points = np.concatenate([points, base])
    cameras = _framed(points, SIDES, tile, tangent=TANGENT, filled=FILLED)
    farthest = max(-float(camera.position @ camera.forward) for camera in cameras.values())
    placed = {}
    for side, camera in cameras.items():
        back = farthest + float(camera.position @ camera.forward)
        up = LOWERED * TANGENT * farthest
        placed[side] = replace(camera, position=camera.position - back * camera.forward + up * camera.up)
    return placed


def _framed(
    points: Float[np.ndarray, "n 3"],
    sides: dict[str, tuple[float, float]],
    tile: tuple[int, int],
    *,
    tangent: float,
    filled: float,
) -> dict[str, Camera]:
    """Return the camera that frames points from each side."""
    return {
        side: framing_camera(
            points,
            azimuth=np.radians(azimuth),
            elevation=np.radians(elevation),
            aspect=tile[0] / tile[1],
            tangent=tangent,
            filled=filled,
        )
        for side, (azimuth, elevation) in sides.items()
    }


def _heading(text: str, width: int, tile_height: int) -> UInt8[np.ndarray, "height width 3"]:
    """Return one line of text, cut where it is too long."""
    margin, font = round(MARGIN * tile_height), ImageFont.load_default(TEXT * tile_height)
    sheet = Image.new("RGB", (width, round(TEXT * tile_height) + 2 * margin), "white")
    text = _fitting(text, font, width - 2 * margin)
    ImageDraw.Draw(sheet).text((margin, margin), text, fill=TITLE_COLOUR, font=font)
    return np.asarray(sheet)


def _fitting(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: int) -> str:
    if font.getlength(text) <= width:
        return text
    while text and font.getlength(f"{text}...") > width:
        text = text[:-1]
    return f"{text}..."


def _legend(hand: Hand, pixels_per_metre: float, width: int, tile_height: int) -> UInt8[np.ndarray, "height width 3"]:
    """Return what each colour means, in as many lines as it takes, and the bar of the scale."""
    size, margin = round(SMALL * tile_height), round(MARGIN * tile_height)
    font = ImageFont.load_default(size)
    bar = _round_length(BAR * width / pixels_per_metre)
    bar_text, bar_width = f"{1e3 * bar:g} mm", round(bar * pixels_per_metre)
    bar_left = width - margin - round(font.getlength(bar_text)) - size // 2 - bar_width
    entries = list(hand_legend(hand).items())
    texts = [_fitting(text, font, bar_left - 3 * (margin + size)) for text, _ in entries]
    places: list[tuple[int, int]] = []
    x, y = margin, margin
    for text in texts:
        entry_width = round(font.getlength(text)) + 2 * size + margin
        if x + entry_width > bar_left:
            x, y = margin, y + size + margin
        places.append((x, y))
        x += entry_width
    sheet = Image.new("RGB", (width, y + size + margin), "white")
    draw = ImageDraw.Draw(sheet)
    for (left, top), text, (_, colour) in zip(places, texts, entries, strict=True):
        fill = tuple(round(255 * channel) for channel in colour)
        draw.rectangle((left, top, left + size, top + size), fill=fill)
        draw.text((left + 1.5 * size, top - size // 8), text, fill=TITLE_COLOUR, font=font)
    right, middle, half, line = bar_left + bar_width, margin + size // 2, size // 3, max(1, size // 6)
    draw.line([(bar_left, middle), (right, middle)], fill=TITLE_COLOUR, width=line)
    for end in (bar_left, right):
        draw.line([(end, middle - half), (end, middle + half)], fill=TITLE_COLOUR, width=line)
    draw.text((right + size // 2, margin - size // 8), bar_text, fill=TITLE_COLOUR, font=font)
    return np.asarray(sheet)


def _round_length(longest: float) -> float:
    """Return the greatest of 1, 2, 5, 10, ... that is not above `longest`."""
    power = 10.0 ** np.floor(np.log10(longest))
    return float(max(step * power for step in (1, 2, 5) if step * power <= longest))


ARM_TILE = (720, 760)  # pixels of each picture, width and height
ARM_SIZE = 0.35  # [m] of the robot as it is shown, where light and shadows look best
ARM_SIDES = {"front": (28.0, 18.0), "side": (-82.0, 12.0)}  # [deg] azimuth and elevation of the camera
ARM_TANGENT = 0.15  # of half the vertical angle of view
ARM_FILLED = 0.86  # of each picture by the robot
TITLE_ROOM = 0.03  # [m] above the robot, at the shown size
AXIS_LENGTH, AXIS_RADIUS = 0.04, 0.0016  # [m] at the shown size
AXES: tuple[Colour, ...] = ((0.82, 0.08, 0.16), (0.10, 0.60, 0.20), (0.12, 0.30, 0.86))  # x, y, z


def arm_picture(arm: Arm | Robot, *, tile: tuple[int, int] = ARM_TILE) -> UInt8[np.ndarray, "height width 3"]:
    """Return an arm, or a robot, at home from two sides as sRGB bytes; x, y and z of base and flange are red, green, blue.

    tile: width and height of each side in pixels.
    """
    view = VisualScene(tuple(_parts(arm)), np.zeros((0, 3)), np.zeros(3))
    points = np.concatenate([part.vertices_in_world() for part in view.parts])
    points = np.concatenate([points, points.max(axis=0)[None] + [0.0, 0.0, TITLE_ROOM]])
    cameras = _framed(points, ARM_SIDES, tile, tangent=ARM_TANGENT, filled=ARM_FILLED)
    pictures = [render_array(view, size=tile, camera=camera) for camera in cameras.values()]
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
    scale = ARM_SIZE / float(np.ptp(np.concatenate(points), axis=0).max())
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
