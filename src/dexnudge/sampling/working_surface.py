"""Where on the object a fingertip can work for the motion, and the pull that brings an idle one there.

A contact that faces the motion can only push the object back. The force balance then leaves it without force, and a contact
without force has no gradient: nothing tells the finger that the edge to a better face is near. So such a fingertip is drawn
to the nearest place where one fits between object and environment and the surface does not face the motion.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from dexnudge.geometry.exact_distance import ExactDistance

FACING_MOTION = (
    0.5  # cosine of outward normal and motion from which a contact pushes back more than friction carries on
)
WORKING = 0.2  # the same cosine up to which a place is worth going to
TIP_RADIUS = 0.008  # [m] of a fingertip, the way from its keypoint to the surface that it touches
ROOM = 0.006  # [m] that the environment must leave around the keypoint; fingertips are flat in front


@dataclass(frozen=True)
class WorkingSurface:
    """Places for the keypoint of a fingertip, frame C; `places` may be empty.

    Attributes:
        motion: unit vector. places: [m], a fingertip's radius above the object's surface.
    """

    motion: Float[Tensor, " 3"]
    places: Float[Tensor, "place 3"]

    def idle(self, normals: Float[Tensor, "batch digit 3"]) -> Bool[Tensor, "batch digit"]:
        """Which contacts face the motion, by the object's outward normals; none where there is no better place."""
        return (normals @ self.motion > FACING_MOTION) & bool(len(self.places))

    def nearest(
        self, points: Float[Tensor, "batch digit 3"], normals: Float[Tensor, "batch digit 3"]
    ) -> Float[Tensor, "batch digit 3"]:
        """The place nearest to that of a fingertip which touches at `points` [m]; any where there is no place."""
        here = (points + TIP_RADIUS * normals).flatten(0, 1)
        if len(self.places) == 0:
            return here.view(points.shape)
        return self.places[torch.cdist(here, self.places).argmin(dim=1)].view(points.shape)


def working_surface(
    cloud: Float[Tensor, "point 6"], motion: Float[Tensor, " 3"], environment: ExactDistance
) -> WorkingSurface:
    """From points and outward normals of the object [m], and the distance to what surrounds it; one frame."""
    points, normals = cloud[:, :3], cloud[:, 3:]
    places = points + TIP_RADIUS * normals
    room = torch.as_tensor(environment(places.double().numpy()).distance)
    return WorkingSurface(motion, places[(normals @ motion < WORKING) & (room > ROOM)])
