"""A sampler's scene is prepared once, and again where anything of it has changed."""

import gc
import weakref
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from dexnudge.sampling import problem
from dexnudge.sampling.problem import PreparedScene
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.uncertainty import Uncertainty


@pytest.fixture
def prepared(monkeypatch: pytest.MonkeyPatch) -> list[Scene]:
    """The scenes that have been prepared so far."""
    made: list[Scene] = []
    prepare = problem.prepare
    monkeypatch.setattr(problem, "prepare", lambda scene, **device: made.append(scene) or prepare(scene, **device))
    return made


def test_the_same_scene_is_prepared_once(scene: Scene, prepared: list[Scene]) -> None:
    known = PreparedScene("cpu")
    first, renamed = known(scene), replace(scene, name="again", parameters={"anything": object()})
    assert known(scene).fields is first.fields
    again = known(renamed)
    assert again.fields is first.fields
    assert again.scene is renamed
    assert len(prepared) == 1


@pytest.mark.parametrize(
    "change",
    [{"mass": 0.3}, {"motion": np.array([0.6, 0.8, 0.0])}, {"uncertainty": Uncertainty(mass=(0.5, 2.0))}],
    ids=str,
)
def test_a_scene_with_another_number_is_prepared_anew(scene: Scene, prepared: list[Scene], change: dict) -> None:
    known = PreparedScene("cpu")
    known(scene)
    other = replace(scene, **change)
    assert known(other).scene is other
    assert prepared == [scene, other]


def test_a_mesh_that_was_changed_in_place_is_prepared_anew(scene: Scene, prepared: list[Scene]) -> None:
    known, own = PreparedScene("cpu"), replace(scene, environment_mesh=scene.environment_mesh.copy())
    before = known(own)
    own.environment_mesh.vertices[:, 2] -= 0.001
    assert known(own).fields is not before.fields
    assert len(prepared) == 2


def test_only_the_last_scene_is_kept(scene: Scene, prepared: list[Scene]) -> None:
    known, other = PreparedScene("cpu"), replace(scene, mass=0.3)
    for each in (scene, other, scene):
        known(each)
    assert len(prepared) == 3


@pytest.fixture
def no_collector() -> Iterator[None]:
    """Python's collector does not begin by itself."""
    gc.disable()
    yield
    gc.enable()


@pytest.mark.usefixtures("no_collector")
def test_old_scenes_are_freed(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(problem, "RELEASED_AFTER", 4)
    known, meshes = PreparedScene("cpu"), []
    for number in range(4):
        surroundings = scene.environment_mesh.copy()
        meshes.append(weakref.ref(surroundings))
        known(replace(scene, environment_mesh=surroundings, seed=number))
    del surroundings
    assert sum(mesh() is not None for mesh in meshes) == 1
