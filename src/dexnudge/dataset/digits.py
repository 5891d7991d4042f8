"""Which joint angles belong to which digit of a hand."""

from dexnudge.errors import DatasetError
from dexnudge.hands.hand import Hand


def digit_joints(hand: Hand) -> dict[str, tuple[int, ...]]:
    """Digit name -> indices into `hand.joint_names`, from the palm outwards.

    A digit owns the joints between its fingertip and the palm; a joint that several digits share goes to the first of
    them, so that every joint has one digit. Raises DatasetError for a joint that leads to no fingertip.
    """
    owned: set[int] = set()
    digits: dict[str, tuple[int, ...]] = {}
    for digit, fingertip in hand.fingertips.items():
        joints: list[int] = []
        link = hand.link_names.index(fingertip)
        while link > 0:
            joint = hand.joints[link]
            if joint is not None and joint.index is not None and joint.index not in owned:
                owned.add(joint.index)
                joints.append(joint.index)
            link = int(hand.link_parent[link])
        if joints:
            digits[digit] = tuple(reversed(joints))
    orphans = [name for index, name in enumerate(hand.joint_names) if index not in owned]
    if orphans:
        raise DatasetError(
            f"joints {', '.join(orphans)} of hand {hand.name!r} lead to no fingertip; "
            f"expected every joint between the palm and one of {', '.join(hand.fingertips)}; add the fingertip link."
        )
    return digits
