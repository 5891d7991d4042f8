"""Keep the whole hand out of a box in the world: a glass beside the object, a person's side of the table.

python examples/keep_out_box.py
"""

from dataclasses import dataclass

import torch

import dexnudge as dn


@dataclass(frozen=True)
class KeepOutBox:
    """Sum over the hand's surface points of their squared depth in a box, E = sum_p max(0, depth(p))^2 [m^2].

    `lower` and `upper` are corners of the box in the world [m]; it is grown by `clearance` [m].
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    clearance: float = 0.01
    name: str = "keep_out_box"
    weight: float = 1.0

    def __call__(self, hands: dn.HandBatch, scene: dn.Scene) -> torch.Tensor:
        """Return the energy of each hand."""
        return self.depths(hands).square().sum(dim=1)

    def depths(self, hands: dn.HandBatch) -> torch.Tensor:
        """Return how deep each surface point is in the grown box [m], (batch, point); 0 outside."""
        above = hands.points - hands.q.new_tensor(self.lower) + self.clearance
        below = hands.q.new_tensor(self.upper) + self.clearance - hands.points
        return torch.minimum(above, below).amin(dim=2).clamp_min(0.0)


def main(num: int = 32) -> None:
    """Draw hands for a phone on a table, anywhere and then only on one side of it."""
    hand, scene = dn.load_hand("shadow_lite"), dn.build_scene("table", "phone", seed=0)
    x, y, z = scene.T_world_object[:3, 3].tolist()
    box = KeepOutBox(lower=(x - 0.5, y, z - 0.1), upper=(x + 0.5, y + 0.5, z + 0.5))
    for terms in ([], [box]):
        samples = dn.Sampler(hand, terms=terms).sample(scene, num=num, seed=0)
        hands = dn.HandBatch(hand, torch.as_tensor(samples.q))
        outside = (box.depths(hands) <= box.clearance).all(dim=1)
        print(f"{len(terms)} terms: {samples.num_verified} of {num} verified, {int(outside.sum())} outside the box")


if __name__ == "__main__":
    main()
