"""How far a push should carry an object: its whole motion, but no farther than to where the object can be grasped."""

from dexnudge.made_once import made_once
from dexnudge.planning.object_motion import NoObjectMotion, plan_object_motion
from dexnudge.scenes.scene import Scene


@made_once
def push_length(scene: Scene) -> float:
    """`scene.motion_length` [m], or the shorter way after which the object is graspable over an edge.

    Beyond that, 30 % of its length hang over and a grasp takes over; some centimetres farther the support would no longer
    carry the object, and nothing that slides on it could be in balance.
    """
    plan = plan_object_motion(scene, own_motion_only=True)
    if isinstance(plan, NoObjectMotion) or plan.length == 0.0:
        return scene.motion_length
    return min(scene.motion_length, plan.length)
