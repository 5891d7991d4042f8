"""Stay near a preferred posture: a half-closed hand, the one that a teleoperator holds, the last one in a sequence.

python examples/preferred_posture.py
"""

from dataclasses import dataclass

import torch

import dexnudge as dn


@dataclass(frozen=True)
class PreferredPosture:
    """Mean squared deviation of the joint angles from a preferred posture [rad^2], one angle for each joint."""

    joint_angles: tuple[float, ...]
    name: str = "preferred_posture"
    weight: float = 0.02

    def __call__(self, hands: dn.HandBatch, scene: dn.Scene) -> torch.Tensor:
        """Return the energy of each hand."""
        return (hands.joint_angles - hands.q.new_tensor(self.joint_angles)).square().mean(dim=1)


def main(num: int = 32) -> None:
    """Draw hands for a phone on a table, in any posture and then near the middle of all joint ranges."""
    hand, scene = dn.load_hand("shadow_lite"), dn.build_scene("table", "phone", seed=0)
    middle = (hand.lower + hand.upper) / 2
    for terms in ([], [PreferredPosture(tuple(middle.tolist()))]):
        samples = dn.Sampler(hand, terms=terms).sample(scene, num=num, seed=0)
        deviation = abs(samples.q[:, 9:] - middle).mean()
        print(f"{len(terms)} terms: {samples.num_verified} of {num} verified, {deviation:.2f} rad from the posture")


if __name__ == "__main__":
    main()
