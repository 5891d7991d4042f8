"""A changed model is the one that the changed scene would have been compiled to."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from dexnudge.errors import InputError
from dexnudge.hands.shadow_lite import shadow_lite
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.push_model import QUANTITIES, changed_physics, load_push_model, push_model_xml

DECIDED = ("geom_friction", "body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "dof_invweight0")


@pytest.fixture(scope="module")
def hand():
    return shadow_lite()


@pytest.fixture(scope="module")
def scene():
    slab = trimesh.creation.box(bounds=[[-0.5, -0.5, -0.05], [0.5, 0.5, -0.01]])
    return Scene(trimesh.creation.box((0.14, 0.07, 0.02)), slab, np.eye(4), np.array([1.0, 0, 0]))


@pytest.fixture(scope="module")
def push(hand, scene):
    return load_push_model(push_model_xml(hand, scene), hand, scene)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_it_equals_the_model_of_the_changed_scene(hand, scene, push, quantity):
    other = replace(scene, **{quantity: 1.5 * getattr(scene, quantity)})
    expected = load_push_model(push_model_xml(hand, other), hand, other).model
    before = {name: getattr(push.model, name).copy() for name in DECIDED}
    changed = changed_physics(push, quantity, 1.5).model
    for name in DECIDED:
        np.testing.assert_allclose(getattr(changed, name), getattr(expected, name), rtol=1e-5, atol=1e-12, err_msg=name)
        np.testing.assert_array_equal(getattr(push.model, name), before[name])
    assert any(not np.allclose(getattr(changed, name), before[name], rtol=1e-3) for name in DECIDED)


def test_an_unknown_quantity_is_refused(push):
    with pytest.raises(InputError, match="'gravity' cannot be changed in a model; expected one of friction_hand"):
        changed_physics(push, "gravity", 2.0)
