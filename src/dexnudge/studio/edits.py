"""What the page changes of a scene before it is sampled: where the object lies, how it should move, masses and frictions."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.scenes.files import NUMBERS
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.scene import Scene

TURNS_IN_PLACE = 0.9  # cosine of a turn's axis with the support's normal; of a tip they are perpendicular


@dataclass(frozen=True, eq=False)
class Edits:
    """Changes of a scene.

    Attributes:
        moved: rigid transform of the object from where it lies, world.
        heading: by which the motion is turned about the support's normal [deg].
        turn: angle of a turn in place [deg]; 0 for none.
        tip: angle of a tip over an edge [deg]; 0 for none.
        numbers: those of the scene, by their names in `Scene`.
    """

    moved: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    heading: float = 0.0
    turn: float = 0.0
    tip: float = 0.0
    numbers: dict[str, float] = field(default_factory=dict)

    @classmethod
    def none(cls, scene: Scene) -> Edits:
        """Return the edits that leave a scene as it is."""
        turn, tip = 0.0, 0.0
        if scene.turn is not None:
            angle, along = float(np.degrees(scene.turn.angle)), float(scene.turn.axis @ up(scene))
            turn, tip = (np.sign(along) * angle, 0.0) if abs(along) > TURNS_IN_PLACE else (0.0, angle)
        return cls(turn=float(turn), tip=float(tip), numbers={name: float(getattr(scene, name)) for name in NUMBERS})

    def applied(self, scene: Scene) -> Scene:
        """Return the scene as it is asked for; one whose object or motion changed is understood anew, as one's own is.

        Raises:
            SceneError: the object is inside its surroundings or away from them, or the motion is invalid.
        """
        before = Edits.none(scene)
        if np.allclose(self.moved, np.eye(4)) and (self.heading, self.turn, self.tip) == (0.0, before.turn, before.tip):
            numbers: dict[str, Any] = self.numbers
            return scene if numbers == before.numbers else replace(scene, **numbers)
        asked: dict[str, Any] = {"turn_deg": self.turn or None, "tip_deg": self.tip or None, **self.numbers}
        return Scene.from_files(
            scene.object_mesh,
            environment=scene.environment_mesh,
            object_pose=self.moved @ scene.T_world_object,
            motion=self.direction(scene),
            surface_noise=scene.surface_noise,
            clearance=scene.clearance,
            **asked,
        )

    def preview(self, scene: Scene) -> Scene:
        """Return what the changes look like, before anything is understood; a tip is shown once it is sampled.

        Raises:
            SceneError: a number out of its domain.
        """
        before = Edits.none(scene)
        turn = scene.turn if (self.turn, self.tip) == (before.turn, before.tip) else None
        if self.turn and turn is None:
            centre = self.moved[:3, :3] @ scene.centre_of_mass + self.moved[:3, 3]
            turn = Turn(abs(np.radians(self.turn)), np.sign(self.turn) * up(scene), centre)
        pose = self.moved @ scene.T_world_object
        numbers: dict[str, Any] = self.numbers
        return replace(scene, T_world_object=pose, motion=self.direction(scene), turn=turn, **numbers)

    def direction(self, scene: Scene) -> Float[np.ndarray, "3"]:
        """Return the direction of the slide, world."""
        return Rotation.from_rotvec(np.radians(self.heading) * up(scene)).apply(scene.motion)


def up(scene: Scene) -> Float[np.ndarray, "3"]:
    """Return the normal of what carries a scene's object; z where nothing flat does."""
    below = [support for support in scene.supports if support.side == "below"]
    return np.asarray(below[0].normal, dtype=float) if below else np.array([0.0, 0.0, 1.0])
