"""A lift rehearsed before it is tried: the grasp in free space, the object heavier and more slippery than it should be."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from jaxtyping import Float

from dexnudge.hands.hand import Hand
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.sliding_task import GRAVITY
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.episode import CLOSE_RAMP, CLOSE_TIME, SETTLE_TIME, Episode
from dexnudge.simulation.hand_path import waiting
from dexnudge.simulation.hold import ObjectPose
from dexnudge.simulation.push_model import ENVIRONMENT_SIDE, HAND_SIDE, PushModel, load_push_model
from dexnudge.simulation.squeeze import squeeze

HEAVIER = 1.25  # times the mass: what a scale or a guess may be wrong by
SLIPPERIER = 0.75  # times the friction of the hand
HELD_TIME = 1.0  # [s]


@dataclass(frozen=True)
class LiftRehearsal:
    """Rehearses grasps of one hand on one object; `friction` of the hand in it, `half_length` of the object [m]."""

    push: PushModel
    friction: float
    half_length: float

    def __call__(
        self,
        q: Float[np.ndarray, " coordinates"],
        contacts: HandContacts,
        T_world_object: Float[np.ndarray, "4 4"],
    ) -> float:
        """How far the object moves under its weight, as a share of what the hold test allows; infinite if it diverges.

        The grasp is given by q and contacts, world frame, with the object at `T_world_object`: gravity acts as it will then.
        """
        push = replace(self.push, T_world_object=T_world_object)
        push.model.opt.gravity[:] = 0.0
        episode = Episode(push, q, recorded=False)
        start = _pose(push)
        torque = squeeze(push, contacts, half_length=self.half_length, friction=self.friction).motor_torque
        episode.close(torque, "close", ramp=CLOSE_RAMP, seconds=CLOSE_TIME)
        episode.play(waiting(q, seconds=SETTLE_TIME), "close")
        push.model.opt.gravity[:] = 0.0, 0.0, -GRAVITY
        episode.play(waiting(q, seconds=HELD_TIME), "hold")
        return float("inf") if episode.diverged else start.share(_pose(push))


def lift_rehearsal(xml: str, hand: Hand, scene: Scene) -> LiftRehearsal:
    """The rehearsal for what `push_model_xml(hand, scene)` wrote; the surroundings are left out of it."""
    push = load_push_model(xml, hand, scene)
    model = push.model
    surroundings, links = push.side == ENVIRONMENT_SIDE, push.side == HAND_SIDE
    model.geom_contype[surroundings] = model.geom_conaffinity[surroundings] = 0
    model.geom_friction[links] *= SLIPPERIER
    model.body_mass[push.object_body] *= HEAVIER
    model.body_inertia[push.object_body] *= HEAVIER
    mujoco.mj_setConst(model, push.data)
    half_length = 0.5 * float(np.max(scene.object_mesh.extents))
    return LiftRehearsal(push, SLIPPERIER * scene.friction_hand, half_length)


def _pose(push: PushModel) -> ObjectPose:
    data, free = push.data, push.object_position
    return ObjectPose(np.array(data.xipos[push.object_body]), np.array(data.qpos[free + 3 : free + 7]))
