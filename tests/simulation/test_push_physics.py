"""The physics of a push against Coulomb's law: an incline, a slide to rest, a slab pressed from above and dragged."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh

from dexnudge.mechanics.sliding_task import GRAVITY
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.boxes import box
from dexnudge.scenes.motion import Motion
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.contact_forces import normal_forces
from dexnudge.simulation.convex_pieces import link_pieces
from dexnudge.simulation.hand_path import PUSH, SETTLE, PushPath, push_path
from dexnudge.simulation.model import BASE_FORCE_LIMIT, SimulationModel, changed_physics, scene_model
from dexnudge.simulation.push_forces import PushForces
from dexnudge.simulation.rollout import Rollout, Trace
from dexnudge.simulation.success import judge_push, lasting_forces

HEIGHT = 0.02  # [m] of the block
FRICTION_HAND, FRICTION_ENVIRONMENT, MASS = 0.8, 0.4, 0.15
PALM_BOTTOM = 0.11  # [m] from the palm's origin down to the lower face of its box
X = np.array([1.0, 0.0, 0.0])
MOTION = Motion(None, X, 0.05)


@pytest.fixture(scope="module")
def scene() -> Scene:
    pose = np.eye(4)
    pose[2, 3] = HEIGHT / 2
    return Scene(trimesh.creation.box((0.12, 0.06, HEIGHT)), box((-0.5, -0.3, -0.04), (0.5, 0.3, 0.0)), pose, X)


@pytest.fixture(scope="module")
def simulation(pad_hand, scene) -> SimulationModel:
    for (corners,), mesh in zip(link_pieces(pad_hand), pad_hand.link_meshes, strict=True):
        # The closed forms below hold for the boxes themselves, and not for bodies that are cut off by some tolerance.
        np.testing.assert_allclose(np.unique(corners, axis=0), np.unique(mesh.vertices, axis=0), atol=1e-12)
    return scene_model(pad_hand, scene)


def palm_at(height: float) -> np.ndarray:
    """q with the palm's lower face at this height over the table, over the block's centre."""
    return np.array([0.0, 0.0, height + PALM_BOTTOM, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def pressing(simulation: SimulationModel, *forces: tuple[float, float, float]) -> PushForces:
    """The base presses with these forces [N] at the palm's lower face, one a place of the way; the fingers idle."""
    lever = np.array([0.0, 0.0, -PALM_BOTTOM])
    force = np.array(forces)
    return PushForces(
        done=np.linspace(0.0, 1.0, len(force)),
        force=force[:, None],
        motor_torque=np.zeros((len(force), simulation.model.nu)),
        base_wrench=np.concatenate([force, np.cross(lever, force)], axis=1),
        cone_share=np.ones(len(force)),
        surplus=np.ones(len(force)),
        closing=np.zeros(simulation.model.nu),
        base_closing=np.zeros(3),
        link_force=np.zeros((len(force), 3)),
        link_torque=np.zeros((3, simulation.model.nu)),
        link_wrench=np.zeros((3, 6)),
        limit=5.0,
    )


def slide(simulation: SimulationModel, steps: int) -> np.ndarray:
    """Positions of the block's centre along x [m] after each step."""
    moved = []
    for _ in range(steps):
        mujoco.mj_step(simulation.model, simulation.data)
        moved.append(float(simulation.data.xipos[simulation.object_body, 0]))
    return np.array(moved)


@pytest.mark.parametrize(("share", "slips"), [(0.97, False), (1.03, True)])
def test_a_block_on_an_incline_slips_exactly_above_the_friction_angle(simulation, share, slips):
    theta = np.arctan(share * FRICTION_ENVIRONMENT)
    simulation.place(palm_at(0.3))
    try:
        simulation.model.opt.gravity[:] = GRAVITY * np.array([np.sin(theta), 0.0, -np.cos(theta)])
        moved = slide(simulation, 500)
    finally:
        simulation.model.opt.gravity[:] = (0.0, 0.0, -GRAVITY)
    if slips:
        acceleration = GRAVITY * (np.sin(theta) - FRICTION_ENVIRONMENT * np.cos(theta))
        # s = a t^2 / 2 from rest; the first 0.2 s are left to the landing of the block on its contacts
        measured = 2 * (moved[-1] - moved[100]) / (1.0**2 - 0.202**2)
        assert measured == pytest.approx(acceleration, rel=0.1)
    else:
        assert abs(moved[-1] - moved[100]) < 1e-4


def test_a_sliding_block_stops_after_the_distance_of_coulombs_law(simulation):
    simulation.place(palm_at(0.3))
    slide(simulation, 50)
    start, speed = float(simulation.data.xipos[simulation.object_body, 0]), 0.5
    free = simulation.model.joint("pushed object").dofadr[0]
    simulation.data.qvel[free] = speed
    moved = slide(simulation, 250)
    assert moved[-1] - start == pytest.approx(speed**2 / (2 * FRICTION_ENVIRONMENT * GRAVITY), rel=0.05)
    assert abs(float(simulation.data.qvel[free])) < 1e-3


def pushed(simulation: SimulationModel, q: np.ndarray, path: PushPath, forces: PushForces) -> Rollout:
    rollout = Rollout(simulation, q)
    rollout.push(path, forces)
    return rollout


def drag(simulation: SimulationModel, normal: float) -> tuple[Trace, PushPath]:
    """Press from above with this force [N] and carry along by 5 cm."""
    pull = FRICTION_ENVIRONMENT * (MASS * GRAVITY + normal)
    q = palm_at(HEIGHT)
    path = push_path(np.zeros(1), q[None], motion=MOTION, length=0.05)
    force = (min(pull, FRICTION_HAND * normal), 0.0, -normal)
    return pushed(simulation, q, path, pressing(simulation, force)).trace, path


@pytest.mark.parametrize(("share", "follows"), [(0.9, False), (1.2, True)])
def test_a_pressed_slab_follows_from_the_force_of_the_closed_form(simulation, share, follows):
    # N >= mu_e m g / (mu_h - mu_e): 1.47 N here
    least = FRICTION_ENVIRONMENT * MASS * GRAVITY / (FRICTION_HAND - FRICTION_ENVIRONMENT)
    run, _ = drag(simulation, share * least)
    verdict = judge_push(run, motion=MOTION, length=0.05, max_normal_force=5.0, diverged=False)
    assert verdict.success is follows
    moving = run.phase == PUSH
    assert np.mean(run.hand_object_force[moving, 0]) == pytest.approx(share * least, rel=0.03)
    if not follows:
        assert verdict.outcome is Outcome.FELL_SHORT
        assert verdict.length_reached < 0.005
        assert verdict.length_asked == 0.05


def test_a_dragged_slab_takes_the_force_that_the_balance_predicts(simulation):
    run, _ = drag(simulation, 4.0)
    steady = (run.phase == PUSH) & (np.abs(run.object_pose[:, 0] - 0.025) < 0.015)
    expected = FRICTION_ENVIRONMENT * (MASS * GRAVITY + 4.0)
    assert np.mean(run.hand_object_force[steady, 1]) == pytest.approx(expected, rel=0.1)


def test_the_press_follows_the_forces_of_the_way(simulation):
    path = push_path(np.zeros(1), palm_at(HEIGHT)[None], motion=MOTION, length=0.05)
    wanted = [(FRICTION_ENVIRONMENT * (MASS * GRAVITY + normal), 0.0, -normal) for normal in (4.0, 3.0, 5.0)]
    run = pushed(simulation, palm_at(HEIGHT), path, pressing(simulation, *wanted)).trace
    for way, expected in ((0.0125, 3.5), (0.025, 3.0), (0.0375, 4.0), (0.045, 4.6)):
        near = (run.phase == PUSH) & (np.abs(run.mocap[:, 0] - way) < 0.0015)
        assert np.mean(run.hand_object_force[near, 0]) == pytest.approx(expected, rel=0.1)


def test_the_forces_of_a_press_are_measured_at_the_link_and_at_the_base(simulation):
    run, _ = drag(simulation, 4.0)
    steady = (run.phase == PUSH) & (np.abs(run.object_pose[:, 0] - 0.025) < 0.015)
    palm = simulation.hand.link_names.index("palm")
    assert run.link_force[steady, palm].mean() == pytest.approx(4.0, rel=0.03)
    assert np.delete(run.link_force, palm, axis=1).max() == 0.0
    np.testing.assert_allclose(run.link_force.sum(axis=1)[steady], run.hand_object_force[steady, 0], rtol=0.01)
    # At constant speed the base balances what the slab does to the palm, whose lower face is a lever under its origin.
    pull = FRICTION_ENVIRONMENT * (MASS * GRAVITY + 4.0)
    np.testing.assert_allclose(run.base_wrench[steady, :3].mean(axis=0), [pull, 0.0, -4.0], atol=0.1)
    turning = run.base_wrench[steady, 3:].mean(axis=0)
    assert turning[1] == pytest.approx(-PALM_BOTTOM * pull, abs=0.03)


@pytest.mark.parametrize(("asked", "made"), [(25.0, 25.0), (60.0, BASE_FORCE_LIMIT)])
def test_the_base_presses_no_harder_than_an_arm(simulation, asked, made):
    path = push_path(np.zeros(1), palm_at(HEIGHT)[None], motion=MOTION, length=0.05)
    run = pushed(simulation, palm_at(HEIGHT), path, pressing(simulation, (0.0, 0.0, -asked))).trace
    down = simulation.base_motor[2]
    assert run.link_force[run.phase == PUSH].sum(axis=1).max() == pytest.approx(made, rel=0.03)
    assert run.base_wrench[:, 2].min() == pytest.approx(-made, rel=0.03)
    assert run.torque_share[:, down].max() == pytest.approx(made / BASE_FORCE_LIMIT, rel=0.03)
    verdict = judge_push(run, motion=MOTION, length=0.05, max_normal_force=100.0, diverged=False)
    assert verdict.link_force == pytest.approx(made, rel=0.03)
    hard = judge_push(run, motion=MOTION, length=verdict.length_reached, max_normal_force=5.0, diverged=False)
    assert hard.outcome is Outcome.PRESSED_TOO_HARD


@pytest.mark.parametrize("cone", [mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtCone.mjCONE_PYRAMIDAL])
def test_normal_forces_are_mujocos(simulation, cone):
    simulation = changed_physics(simulation)
    simulation.model.opt.cone = cone
    simulation.place(palm_at(HEIGHT - 0.0005))
    slide(simulation, 20)
    expected = np.zeros((simulation.data.ncon, 6))
    for index in range(len(expected)):
        mujoco.mj_contactForce(simulation.model, simulation.data, index, expected[index])
    assert expected[:, 0].max() > 0.3
    np.testing.assert_allclose(normal_forces(simulation), expected[:, 0], atol=1e-9)


def test_a_spike_is_no_load():
    time = np.concatenate([0.02 * np.arange(10), [0.186, 0.206]])  # an act may end between two records
    force = np.zeros((12, 3))
    force[4, 0] = 20.0  # for 20 ms: 4 N over 100 ms
    force[2:7, 1] = 6.0  # for 100 ms
    force[10, 2] = 10.0  # for 6 ms of 100
    np.testing.assert_allclose(lasting_forces(time, force), [4.0, 6.0, 10.0 * 0.006 / 0.106], rtol=1e-9)
    np.testing.assert_allclose(lasting_forces(time, force, window=0.02), [20.0, 6.0, 10.0 * 0.006 / 0.026], rtol=1e-9)
    assert lasting_forces(time[:4], force[:4]).tolist() == [0.0, 0.0, 0.0]


def test_a_dragged_slab_does_not_hop(simulation):
    run, _ = drag(simulation, 4.0)
    steady = (run.phase == PUSH) & (np.abs(run.object_pose[:, 0] - 0.025) < 0.015)
    assert np.std(run.hand_object_force[steady, 0]) < 1e-3 * np.mean(run.hand_object_force[steady, 0])
    assert np.ptp(run.object_pose[steady, 2]) < 2e-6


def test_the_base_goes_where_it_is_told(simulation):
    run, path = drag(simulation, 4.0)
    moving = (run.phase == PUSH) & (run.time > 0.9)
    base = run.qpos[moving, simulation.palm_position]
    lag = base - run.mocap[moving, 0]
    assert np.abs(lag).max() < 1e-3
    assert np.ptp(np.diff(base)[3:-8]) < 1e-4  # 20 ms apart: 1 mm each, without jitter
    assert path.position[-1, 0] == pytest.approx(0.05)
    assert path.velocity[:, 0].max() == pytest.approx(0.05, rel=1e-6)


def test_the_same_push_gives_the_same_numbers_whatever_ran_before(simulation):
    first, _ = drag(simulation, 2.0)
    drag(simulation, 4.0)
    again, _ = drag(simulation, 2.0)
    for name in ("qpos", "hand_object_force", "hand_environment_clearance"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))


def test_a_run_out_of_hand_is_stopped_and_can_be_replayed(simulation):
    q = palm_at(0.2)
    path = push_path(np.zeros(1), q[None], motion=MOTION, length=0.05)
    simulation = changed_physics(simulation)
    simulation.model.actuator_forcelimited[simulation.base_motor] = False
    rollout = pushed(simulation, q, path, pressing(simulation, (0.0, 0.0, 1e6)))
    trace, divergence = rollout.trace, rollout.divergence
    assert divergence.step >= divergence.last_step > 0
    assert (
        judge_push(trace, motion=MOTION, length=0.05, max_normal_force=5.0, diverged=True).outcome is Outcome.DIVERGED
    )
    mujoco.mj_setState(simulation.model, simulation.data, divergence.state, mujoco.mjtState.mjSTATE_INTEGRATION)
    np.testing.assert_array_equal(simulation.data.qpos, trace.qpos[-1])


def test_a_hand_pressed_into_the_table_fails(simulation):
    q = palm_at(0.0)
    q[0] = 0.2  # beside the block
    path = push_path(np.zeros(1), q[None], motion=MOTION, length=0.05)
    lowered = replace(path, position=path.position - [0.0, 0.0, 0.01])
    q[2] -= 0.004
    run = pushed(simulation, q, lowered, pressing(simulation, (0.0, 0.0, 0.0))).trace
    assert run.phase[0] == SETTLE
    assert run.hand_environment_depth[1] > 0.002
    assert run.hand_environment_clearance[0] == pytest.approx(-0.004, abs=2e-4)
