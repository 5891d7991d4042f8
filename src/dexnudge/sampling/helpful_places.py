"""Where one more fingertip would help the force balances most: a turn needs couples, and a tip something that holds it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from dexnudge.energies.force_residual import SlidingBalance
from dexnudge.mechanics.friction_cone import friction_cone_edges, wrenches

REACH = 0.04  # [m] at which a place is worth half as much to a fingertip as where it is
DETOUR = 2.0  # ways for one way behind the surface
STRIDE = 0.015  # [m] a target is no farther off than this: what pulls harder pulls a finger through the object
FORWARD = np.array([1.0, 0.0, 0.0])  # of frame C


@dataclass(frozen=True)
class HelpfulPlaces:
    """Places of a fingertip's keypoint on the object, frame C, and what it could do there; there may be none.

    Attributes:
        places: [m].
        normals: outward, of the object's surface there.
        wrenches: of each balance and edge of the friction cone there, per unit normal force, as in `SlidingBalance`.
        max_normal: see there.
    """

    places: Float[Tensor, "place 3"]
    normals: Float[Tensor, "place 3"]
    wrenches: Float[Tensor, "balance place edge 6"]
    max_normal: float

    def to(self, device: str) -> "HelpfulPlaces":
        """Return the same on another device."""
        places, normals, wrenches = (each.to(device) for each in (self.places, self.normals, self.wrenches))
        return HelpfulPlaces(places, normals, wrenches, self.max_normal)

    def help(self, residual: Float[Tensor, "batch balance 6"]) -> Float[Tensor, "batch place"]:
        """Return by how much a force along one edge at a place lowers half the squares of the residual wrenches."""
        slope = -torch.einsum("spew,bsw->bspe", self.wrenches, residual)
        square = self.wrenches.square().sum(dim=-1)
        force = (slope / square).clamp(0.0, self.max_normal)
        return (force * slope - 0.5 * force.square() * square).amax(dim=-1).sum(dim=1)

    def __call__(
        self,
        residual: Float[Tensor, "batch balance 6"],
        loaded: Bool[Tensor, "batch digit"],
        tips: Float[Tensor, "batch digit 3"],
    ) -> tuple[Bool[Tensor, "batch digit"], Float[Tensor, "batch digit 3"]]:
        """Return which fingertip of each hand should go elsewhere, and where to: the one without force that would help most.

        residual, loaded: of the balances, see `ForceResidual`. tips: where the keypoints are [m].
        """
        way = self.places - tips[:, :, None]
        # A fingertip behind the surface has to go around it.
        behind = torch.einsum("bdpx,px->bdp", way, self.normals).clamp_min(0.0)
        far = way.norm(dim=3) + DETOUR * behind
        worth = self.help(residual)[:, None] / (1.0 + (far / REACH).square())
        worth[loaded] = 0.0
        best, place = worth.max(dim=2)
        drawn = (best > 0.0) & (best == best.amax(dim=1, keepdim=True))
        step = way.gather(2, place[..., None, None].expand(-1, -1, 1, 3))[:, :, 0]
        return drawn, tips + step * (STRIDE / step.norm(dim=2, keepdim=True).clamp_min(STRIDE))


def helpful_places(
    places: Float[Tensor, "place 3"], surface: Float[Tensor, "place 6"], balances: Sequence[SlidingBalance]
) -> HelpfulPlaces:
    """Return what fingertips whose keypoints are at `places` could do on the surface's points [m] with these normals."""
    points, normals = surface.double().numpy()[:, :3], surface.double().numpy()[:, 3:]
    found = []
    for balance in balances:
        edges = friction_cone_edges(normals, FORWARD, friction=balance.friction_hand)
        centre = balance.centre_of_mass.double().numpy()
        found.append(wrenches(points[:, None], edges, centre=centre, half_length=balance.half_length))
    return HelpfulPlaces(places, surface[:, 3:], torch.from_numpy(np.stack(found)).float(), balances[0].max_normal)
