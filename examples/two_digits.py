"""Only hands that touch the object with at least two digits, so that it does not turn about one.

python examples/two_digits.py
"""

from dataclasses import dataclass

import numpy as np

import dexnudge as dn


@dataclass(frozen=True)
class DigitsInContact:
    """Number of digits with a link that touches the object; the palm is none."""

    least: int = 2
    name: str = "digits_in_contact"

    def __call__(self, hands: dn.HandBatch, scene: dn.Scene) -> dn.CriterionResult:
        """Judge each hand."""
        digit = hands.hand.digit_of_link
        touching = [{digit[link] for link in links} - {None} for links in dn.measure(hands, scene).contact_links]
        count = np.array([len(digits) for digits in touching])
        return dn.CriterionResult(
            count, count >= self.least, f"fewer than {self.least} digits touch; draw more (`num`)"
        )


def main() -> None:
    """Draw hands for a phone on a table, and say how many touch it with two digits."""
    hand, scene = dn.load_hand("shadow_lite"), dn.build_scene("table", "phone", seed=0)
    criteria = [*dn.default_criteria(), DigitsInContact()]
    print(dn.Sampler(hand).sample(scene, num=32, seed=0, criteria=criteria))


if __name__ == "__main__":
    main()
