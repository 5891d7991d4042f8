"""The force balance that guides, solved at contacts of one's own instead of those of an evaluation."""

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.energies.force_residual import Contacts, ForceResidual
from dexnudge.geometry.warp_runtime import wp


def solve(
    force: ForceResidual,
    points: Float[Tensor, "batch contact 3"],
    normals: Float[Tensor, "batch contact 3"],
    counts: Float[Tensor, "batch contact"] | None = None,
    *,
    sweeps: int,
) -> None:
    """Update residual and gradient; `normals` point out of the object, `counts` is 1 where a contact counts."""
    counted = torch.ones(points.shape[:2]) if counts is None else counts
    contacts = Contacts()
    contacts.links = wp.array(range(points.shape[1]), dtype=int, device=force.device)
    contacts.points = wp.from_torch(points.contiguous(), dtype=wp.vec3)
    contacts.normals = wp.from_torch(normals.contiguous(), dtype=wp.vec3)
    contacts.wanted = wp.from_torch(counted)
    contacts.pull, contacts.pull_weight = wp.zeros_like(contacts.points), 1.0
    every_row = wp.array(range(len(points)), dtype=int, device=force.device)
    for launch in force.launches(contacts, every_row, sweeps=sweeps):
        launch.launch()
