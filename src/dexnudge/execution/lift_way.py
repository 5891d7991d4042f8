"""The way of a grasped object up: straight, or first out of what is above it."""

import numpy as np
from jaxtyping import Float

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_points import surface_points
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.planning.hand_clearance import HandClearance
from dexnudge.planning.hand_states import palm_pose
from dexnudge.scenes.scene import Scene

OUTWARD = tuple(np.arange(0.0, 0.401, 0.04))  # [m] along the motion before the lift, the least first
RAISE = 0.004  # [m] off the support before it moves outward: the springs of the base give way by 1.5 mm
STEP = 0.005  # [m] between the places that are looked at
SPACING = 0.005  # [m] between the points of the object
ROOM = 0.001  # [m] that hand and object keep on the way, or what they have at its start
ALLOWANCE = 0.0005  # [m] less than at the start: rounding and what contacts yield


class LiftWay:
    """Ways up for one hand that holds the object of one scene."""

    def __init__(self, hand: Hand, scene: Scene, *, height: float) -> None:
        self._scene, self._height = scene, height
        self._hand = HandClearance(hand, scene)
        self._environment = ExactDistance(scene.environment_mesh)
        self._points = surface_points(scene.object_in_world(), spacing=SPACING).points

    def __call__(self, q: Float[np.ndarray, " coordinates"]) -> list[Float[np.ndarray, " 3"]] | None:
        """Translations one after another [m, world], by `height` up in all, no farther out than need be; None if blocked."""
        up = np.array([0.0, 0.0, 1.0])
        for outward in OUTWARD:
            ways = [self._height * up]
            if outward > 0:
                ways = [RAISE * up, outward * self._scene.motion, (self._height - RAISE) * up]
            if self._free(q, ways):
                return ways
        return None

    def _free(self, q: np.ndarray, ways: list[np.ndarray]) -> bool:
        shifts, start = [np.zeros(3)], np.zeros(3)
        for way in ways:
            count = int(np.ceil(np.linalg.norm(way) / STEP))
            shifts += [start + way * step / count for step in range(1, count + 1)]
            start = start + way
        pose = palm_pose(q)
        rotation = np.repeat(pose[None, :3, :3], len(shifts), axis=0)
        angles = np.repeat(q[None, ROOT_COORDINATES:], len(shifts), axis=0)
        hand = self._hand(q[:3] + np.array(shifts), rotation, angles).distance[:, 0]
        if (hand < min(ROOM, hand[0] - ALLOWANCE)).any():
            return False
        least = np.inf
        for shift in shifts:
            distance = float(self._environment(self._points + shift).distance.min())
            least = min(ROOM, distance - ALLOWANCE) if least == np.inf else least
            if distance < least:
                return False
        return True
