import ast
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import dexnudge
from dexnudge.errors import InputError
from dexnudge.hands.hand import Hand
from dexnudge.mechanics.balance import balance_problem, problem_margin
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts
from dexnudge.verification.verdicts import Verdicts, contacts_of, verify

Press = Callable[..., np.ndarray]


@pytest.fixture
def press(upright: np.ndarray, tip_height: float) -> Press:
    """Both fingertips `gap` [m] over the block's top, `x` [m] from its middle."""

    def make(gap: float, x: float = 0.0) -> np.ndarray:
        q = upright.copy()
        q[:3] = [x, 0.0, 0.02 + tip_height + gap]
        return q

    return make


def one(verdicts: Verdicts) -> dict[str, object]:
    return {"success": verdicts.success[0], "robust": verdicts.robust[0], "reason": verdicts.reasons[0]} | {
        name: value[0] for name, value in verdicts.values.items()
    }


def test_a_press_with_two_fingers_succeeds_with_its_closed_form(
    boxy_hand: Hand, block_scene: Scene, press: Press
) -> None:
    # 0.8 * 2 * 5 N = 0.4 factor (m g + 2 * 5 N)
    expected = 0.8 * 10 / (0.4 * (0.15 * 9.81 + 10))
    found = verify(block_scene, boxy_hand, np.stack([press(0.0015), press(0.0005), press(-0.0005)]))
    assert found.reasons == ["", "", ""]
    assert found.success.all()
    assert found.robust.all()
    np.testing.assert_allclose(found.force_margin, expected, atol=2e-3)
    assert found.contact_links == [["tip_a", "tip_b"]] * 3
    np.testing.assert_allclose(found.penetration_object, [0, 0, 5e-4], atol=1e-6)
    assert not found.penetration_environment.any()
    assert not found.penetration_self.any()
    assert not found.values["joint_limits"].any()


def test_the_margin_is_that_of_the_reference(boxy_hand: Hand, block_scene: Scene, press: Press) -> None:
    q = np.stack([press(0.001, x) for x in (-0.09, -0.075, -0.05, 0.0, 0.06, 0.08)])
    supports = support_contacts(block_scene)
    reference = [
        problem_margin(balance_problem(each, supports, sliding_task(block_scene)))
        for each in contacts_of(block_scene, boxy_hand, q)
    ]
    np.testing.assert_allclose(verify(block_scene, boxy_hand, q).force_margin, reference, atol=2e-3)


def test_the_contacts_are_those_of_each_configuration_and_none_of_an_invalid_one(
    boxy_hand: Hand, block_scene: Scene, press: Press
) -> None:
    q = np.stack([press(0.001), press(np.nan), press(0.05), press(0.0, 0.03)])
    verdicts = verify(block_scene, boxy_hand, q)
    assert [len(np.unique(each.link)) for each in verdicts.contacts] == [2, 0, 0, 2]
    for row, each in enumerate(verdicts.contacts):
        (alone,) = contacts_of(block_scene, boxy_hand, q[[row]])
        np.testing.assert_allclose(each.points, alone.points, atol=1e-9)
        np.testing.assert_array_equal(each.link, alone.link)


def test_robust_asks_for_more_than_success(boxy_hand: Hand, block_scene: Scene, press: Press) -> None:
    weak = Scene(
        block_scene.object_mesh,
        block_scene.environment_mesh,
        block_scene.T_world_object,
        block_scene.motion,
        friction_hand=0.5,
    )
    found = one(verify(weak, boxy_hand, press(0.001)[None]))
    assert found["success"]
    assert not found["robust"]
    assert 1.0 <= float(str(found["force_margin"])) < 1.5


def change(q: np.ndarray, index: int, value: float) -> np.ndarray:
    q = q.copy()
    q[index] = value
    return q


def test_each_failure_is_named(boxy_hand: Hand, block_scene: Scene, press: Press, tip_height: float) -> None:
    crossed = press(0.2)
    crossed[9:] = [-0.4, -0.4, 0.4, 0.4]
    cases = {
        "valid_pose": change(press(0.001), 0, np.nan),
        "joint_limits": change(press(0.001), 12, 1.001),
        "penetration_environment": change(change(press(0.001), 0, 0.2), 2, tip_height - 0.0011),
        "penetration_object": press(-0.0011),
        "penetration_self": crossed,
        "contact": press(0.0021),
        "": press(0.0019),
    }
    found = verify(block_scene, boxy_hand, np.stack(list(cases.values())))
    assert found.reasons == list(cases)
    assert found.success.tolist() == [False] * 6 + [True]
    assert found.values["joint_limits"][1] == pytest.approx(1e-3)
    assert np.isnan(found.penetration_object[0])
    assert found.force_margin[0] == 0.0


def test_too_little_friction_of_the_hand_is_a_failure_of_force(
    boxy_hand: Hand, block_scene: Scene, press: Press
) -> None:
    oily = Scene(
        block_scene.object_mesh,
        block_scene.environment_mesh,
        block_scene.T_world_object,
        block_scene.motion,
        friction_hand=0.39,
    )
    found = one(verify(oily, boxy_hand, press(0.001)[None]))
    assert found["reason"] == "force_margin"
    assert float(str(found["force_margin"])) < 1.0


def test_a_wall_in_the_way_blocks_the_motion(boxy_hand: Hand, block_scene: Scene, press: Press) -> None:
    wall = trimesh.creation.box(bounds=[[0.0805, -0.1, 0.0], [0.1, 0.1, 0.03]])
    walled = Scene(
        block_scene.object_mesh,
        trimesh.util.concatenate([block_scene.environment_mesh, wall]),
        block_scene.T_world_object,
        block_scene.motion,
    )
    found = one(verify(walled, boxy_hand, press(0.001)[None]))
    assert found["reason"] == "motion_not_blocked"
    assert found["force_margin"] == 0.0


def test_an_obstacle_farther_on_blocks_the_motion_and_is_named(
    boxy_hand: Hand, block_scene: Scene, press: Press
) -> None:
    thing = trimesh.creation.box(bounds=[[0.121, -0.1, 0.0], [0.2, 0.1, 0.006]])
    scene = replace(block_scene, environment_mesh=trimesh.util.concatenate([block_scene.environment_mesh, thing]))
    verdicts = verify(scene, boxy_hand, press(0.001)[None])
    assert verdicts.reasons == ["motion_not_blocked"]
    assert verdicts.values["motion_not_blocked"][0] == pytest.approx(0.041, abs=1e-6)
    sentence = verdicts.sentences["motion_not_blocked"]
    assert sentence.startswith("the object is blocked after 41 mm by something 6 mm high at (0.121, ")
    assert sentence.endswith(
        ", and no hand can help it; choose another `motion` or a shorter `motion_length`, or mend the `object_pose`"
    )
    as_far_as_it_goes = verify(replace(scene, motion_length=0.041), boxy_hand, press(0.001)[None])
    assert as_far_as_it_goes.success.all()
    assert as_far_as_it_goes.values["motion_not_blocked"][0] == pytest.approx(0.041, abs=1e-6)


def test_a_follower_may_not_pass_its_leader(boxy_hand: Hand, block_scene: Scene, press: Press) -> None:
    rows = [change(press(0.2), 10, angle) for angle in (5e-5, 2e-4)]
    found = verify(block_scene, boxy_hand, np.stack(rows))
    assert found.reasons == ["contact", "joint_limits"]
    np.testing.assert_allclose(found.values["joint_limits"], [5e-5, 2e-4])


@pytest.mark.parametrize("columns", [[0, 0, 0, 0, 1, 0], [1, 0, 0, 1, 0, 0], [2, 0, 0, 0, 2, 0], [1, 0, 0, 0, 1, 3e-2]])
def test_what_is_no_rotation_is_invalid(
    boxy_hand: Hand, block_scene: Scene, press: Press, columns: list[float]
) -> None:
    q = press(0.001)
    q[3:9] = columns
    assert verify(block_scene, boxy_hand, q[None]).reasons == ["valid_pose"]


def test_single_precision_is_forgiven(boxy_hand: Hand, block_scene: Scene, press: Press) -> None:
    q = press(0.001)
    turn = np.array([np.cos(0.3), np.sin(0.3), 0, -np.sin(0.3), np.cos(0.3), 0])
    q[3:9] = turn
    assert verify(block_scene, boxy_hand, q[None].astype(np.float32)).reasons == [""]


def test_contacts_lie_on_the_object(boxy_hand: Hand, block_scene: Scene, press: Press) -> None:
    found = contacts_of(block_scene, boxy_hand, np.stack([press(0.001), change(press(0.001), 3, np.inf)]))
    assert found[0].points.shape == (8, 3)  # four on each fingertip
    np.testing.assert_allclose(found[0].points[:, 2], 0.02, atol=1e-6)
    assert found[1].points.shape == (0, 3)


def test_nothing_to_judge_is_no_error(boxy_hand: Hand, block_scene: Scene) -> None:
    found = verify(block_scene, boxy_hand, np.zeros((0, 13)))
    assert found.success.shape == (0,)
    assert found.reasons == []


def test_a_wrong_shape_is_named(boxy_hand: Hand, block_scene: Scene) -> None:
    with pytest.raises(InputError, match=r"shape \(2, 25\); hand 'boxy' expects numbers of shape \(n, 13\)"):
        verify(block_scene, boxy_hand, np.zeros((2, 25)))


def test_what_draws_does_not_use_the_judge() -> None:
    root = Path(dexnudge.__file__).parent
    judging = ("dexnudge.verification", "dexnudge.mechanics.fast_balance", "dexnudge.mechanics.balance")
    verify_afterwards = {"sampler.py", "ranking.py"}
    for folder in ("energies", "sampling", "diffusion"):
        for file in (root / folder).rglob("*.py"):
            if file.name in verify_afterwards:
                continue
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module:
                    assert not node.module.startswith(judging), f"{file} imports {node.module}"
