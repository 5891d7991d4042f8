"""The same model with another friction or mass than was thought: what was planned for the one is played in the other."""

import copy
from dataclasses import replace

import mujoco

from dexnudge.errors import InputError
from dexnudge.simulation.push_model import ENVIRONMENT_SIDE, HAND_SIDE, PushModel

SIDES = {"friction_hand": HAND_SIDE, "friction_environment": ENVIRONMENT_SIDE}
QUANTITIES = (*SIDES, "mass")


def changed_physics(push: PushModel, quantity: str, factor: float) -> PushModel:
    """A model of its own in which one quantity of the scene is multiplied.

    It equals what `push_model_xml` makes of the changed scene; `push` stays as it is. A fingertip's torque about its
    normal is in proportion to its friction, an object's inertia to its mass.

    Raises:
        InputError: the quantity is none of `QUANTITIES`.
    """
    if quantity not in QUANTITIES:
        raise InputError(f"{quantity!r} cannot be changed in a model; expected one of {', '.join(QUANTITIES)}")
    model = copy.deepcopy(push.model)
    if quantity == "mass":
        model.body_mass[push.object_body] *= factor
        model.body_inertia[push.object_body] *= factor
    else:
        model.geom_friction[push.side == SIDES[quantity], :2] *= factor  # sliding and torsional
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)  # what MuJoCo derives from masses at compile time
    return replace(push, model=model, data=data)
