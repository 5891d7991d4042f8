"""Which joint angles belong to which digit of a hand."""

from dexnudge.hands.hand import Hand


def joint_groups(hand: Hand) -> dict[str, tuple[int, ...]]:
    """Digit name -> indices into `hand.joint_names`, from the palm outwards.

    A digit owns the joints between its fingertip and the palm; a joint that several digits share goes to the first of
    them, so that every joint has one digit. Joints that lead to no fingertip, such as a wrist's, come last as "wrist".
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
    others = tuple(index for index in range(len(hand.joint_names)) if index not in owned)
    if others:
        digits["wrist"] = others
    return digits
