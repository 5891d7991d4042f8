"""Only hands whose fingertips can still move every way: a least manipulability of the digits that touch the object.

python examples/manipulability.py
"""

from dataclasses import dataclass

import torch

import dexnudge as dn


@dataclass(frozen=True)
class Manipulability:
    """Least manipulability sqrt(det(J J^T)) [m^3] of the digits that touch; J: fingertip's velocity by joint velocities."""

    least: float = 1e-5
    name: str = "manipulability"

    def __call__(self, hands: dn.HandBatch, scene: dn.Scene) -> dn.CriterionResult:
        """Judge each hand."""
        hand, q = hands.hand, hands.q.detach().requires_grad_()
        coordinates = hand.keypoints(q).sum(dim=0).flatten()  # of each fingertip; hands do not depend on each other
        rows = [torch.autograd.grad(each, q, retain_graph=True)[0][:, 9:] for each in coordinates]
        jacobian = torch.stack(rows, dim=1).unflatten(1, (-1, 3))  # (n, digit, 3, joint)
        volume = torch.linalg.det(jacobian @ jacobian.mT).clamp_min(0.0).sqrt()
        touching = [
            [link in links for link in hand.fingertip_links] for links in dn.measure(hands, scene).contact_links
        ]
        value = volume.masked_fill(~torch.tensor(touching, device=q.device), torch.inf).amin(dim=1)
        return dn.CriterionResult(value, value >= self.least, "a digit that touches the object is stretched or folded")


def main() -> None:
    """Draw hands for a phone on a table, and say how many of them could still move their fingertips."""
    hand, scene = dn.load_hand("shadow_lite"), dn.build_scene("table", "phone", seed=0)
    criteria = [*dn.default_criteria(), Manipulability()]
    print(dn.Sampler(hand).sample(scene, num=32, seed=0, criteria=criteria))


if __name__ == "__main__":
    main()
