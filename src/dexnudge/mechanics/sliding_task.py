"""What the force balance needs to know about the object and its motion, besides where it is touched."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.motion import Twist
from dexnudge.scenes.scene import Scene

GRAVITY = 9.81
"""Acceleration of gravity along world -z [m/s^2]."""


@dataclass(frozen=True, kw_only=True)
class SlidingTask:
    """An object that is to move slowly by a twist under gravity: to slide, to turn or to tip.

    centre: centre of mass, world [m]. half_length: half of the longest bounding-box side [m]; torques are divided
    by it, so that all six rows of a wrench are forces. mass [kg]. twist: at the instant that is balanced, world; the
    object's fastest point moves at 1.
    friction_hand, friction_environment: Coulomb coefficients. max_normal_force: bound on the sum of the normal
    components over the points of one hand link [N].

    Raises InputError on a value outside its domain.
    """

    centre: Float[np.ndarray, "3"]
    half_length: float
    mass: float
    twist: Twist
    friction_hand: float
    friction_environment: float
    max_normal_force: float

    def __post_init__(self) -> None:
        """Refuse values for which the balance has no meaning."""
        positive = {"half_length": self.half_length, "mass": self.mass}
        not_negative = {
            "friction_hand": self.friction_hand,
            "friction_environment": self.friction_environment,
            "max_normal_force": self.max_normal_force,
        }
        for name, value in (positive | not_negative).items():
            if not np.isfinite(value) or value < 0 or (name in positive and value == 0):
                bound = "above 0" if name in positive else "0 or more"
                raise InputError(f"{name} is {value}; expected a finite number {bound}.")
        length = float(np.linalg.norm(self.twist.linear))
        if not self.twist.angular.any() and not abs(length - 1.0) <= 1e-6:
            raise InputError(f"motion has length {length:.6g}; expected a unit vector: divide it by its length.")

    @property
    def weight(self) -> float:
        """Weight of the object [N]."""
        return self.mass * GRAVITY

    def moving(self, twist: Twist) -> SlidingTask:
        """Return the same task with another twist."""
        return replace(self, twist=twist)


@cached_per_instance
def sliding_task(scene: Scene) -> SlidingTask:
    """Return the task of a scene where its motion begins, found once per scene; lengths are of the object in its frame."""
    T_world_object = np.asarray(scene.T_world_object, dtype=np.float64)
    return SlidingTask(
        centre=T_world_object[:3, :3] @ centre_of_mass(scene.object_mesh) + T_world_object[:3, 3],
        half_length=0.5 * float(np.max(scene.object_mesh.extents)),
        mass=float(scene.mass),
        twist=scene.object_motion.twist(),
        friction_hand=float(scene.friction_hand),
        friction_environment=float(scene.friction_environment),
        max_normal_force=float(scene.max_normal_force),
    )


def hardest_task(scene: Scene) -> SlidingTask:
    """Return the task of a scene in the hardest of the worlds that it may be found in."""
    task = sliding_task(scene)
    return task if scene.uncertainty is None else replace(task, **scene.uncertainty.hardest(scene))
