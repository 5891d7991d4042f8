"""What the fused kernel reads and writes: hand, scene, weights, and the state of one evaluation."""

from dexnudge.energies.grid_kernel import PackedGrids
from dexnudge.geometry.warp_runtime import wp
from dexnudge.hands.kinematics import KinematicTree

TERM_ENVIRONMENT = wp.constant(0)
TERM_OBJECT = wp.constant(1)
TERM_SELF = wp.constant(2)
TERM_CONTACT = wp.constant(3)
TERM_TARGET = wp.constant(4)
TERM_SWEEP = wp.constant(5)
TERM_BASE = wp.constant(6)
NUM_TERMS = 7
OBJECT_GRID = wp.constant(0)
ENVIRONMENT_NEAR_GRID = wp.constant(1)
SWEPT_NEAR_GRID = wp.constant(3)
NEAR_TO_FAR = wp.constant(1)  # from a near grid's place to that of its far one
FAR = wp.constant(1.0e6)


@wp.struct
class Clusters:
    """Small groups of neighbouring points with their bounding spheres, in the frame of the points."""

    first: wp.array(dtype=int)  # (C + 1,) where the points of each cluster begin
    centre: wp.array(dtype=wp.vec3)  # (C,) [m]
    radius: wp.array(dtype=float)  # (C,) [m]


@wp.struct
class HandModel:
    """The kinematic tree and the sparse surface points of a hand; constant."""

    tree: KinematicTree
    points: wp.array(dtype=wp.vec3)  # (P,) link frame [m], grouped by cluster
    clusters: Clusters  # grouped by link
    first_cluster: wp.array(dtype=int)  # (L + 1,)
    centre: wp.array(dtype=wp.vec3)  # (L,) of the bounding sphere, link frame [m]
    radius: wp.array(dtype=float)  # (L,) [m]; negative for a link without geometry
    keypoint: wp.array(dtype=wp.vec3)  # (L,) the place that targets pull, link frame [m]
    base: int  # the forearm or adapter behind the palm; -1 where there is none
    partner: wp.array(dtype=int)  # links against which a link's points are tested, grouped by link
    first_partner: wp.array(dtype=int)  # (L + 1,)
    grids: PackedGrids  # one per link


@wp.struct
class SceneFields:
    """Distance grids of object and environment, and points of both that are tested against the links."""

    grids: PackedGrids  # object, environment near and far, and where has_sweep the same two swept
    object_points: wp.array(dtype=wp.vec3)  # [m]
    object_clusters: Clusters
    environment_points: wp.array(dtype=wp.vec3)  # [m]
    environment_clusters: Clusters
    has_environment: int
    has_sweep: int  # 1 where the environment's grids also stand swept along the motion, nowhere above the plain ones


@wp.struct
class EnergyWeights:
    """Weight of each term and the clearances at which the hinges begin [m]."""

    environment: float
    object: float
    self: float
    contact: float
    target: float
    sweep: float
    base: float
    clearance_environment: float
    clearance_object: float
    clearance_self: float
    clearance_base: float
    contact_gap: float
    kept_clear: float  # around the environment; depths in it count from there


@wp.struct
class State:
    """What one evaluation reads and writes."""

    active: wp.array(dtype=int)  # (B,) 0 leaves a hand's results as the last evaluation wrote them
    root_translation: wp.array(dtype=wp.vec3)  # (B,)
    root_rotation: wp.array(dtype=wp.mat33)  # (B,)
    joint_angles: wp.array2d(dtype=float)  # (B, d)
    contact_weight: wp.array2d(dtype=float)  # (B, L)
    target: wp.array2d(dtype=wp.vec3)  # (B, L)
    target_weight: wp.array2d(dtype=float)  # (B, L)
    link_rotation: wp.array2d(dtype=wp.mat33)  # (B, L)
    link_translation: wp.array2d(dtype=wp.vec3)  # (B, L)
    link_centre: wp.array2d(dtype=wp.vec3)  # (B, L) of the bounding sphere
    force: wp.array2d(dtype=wp.vec3)  # (B, L) summed gradient in the points' positions
    moment: wp.array2d(dtype=wp.vec3)  # (B, L) the same crossed with the positions
    extra_force: wp.array2d(dtype=wp.vec3)  # (B, L) gradient that another term puts on the contact point
    contact_point: wp.array2d(dtype=wp.vec3)  # (B, L) the link's point nearest to the object
    contact_distance: wp.array2d(dtype=float)  # (B, L) [m]
    contact_normal: wp.array2d(dtype=wp.vec3)  # (B, L) gradient of the object's distance there
    depth: wp.array2d(dtype=wp.vec3)  # (B, L) deepest sparse point in environment (grown), object, another link [m]
    swept_depth: wp.array2d(dtype=float)  # (B, L) deepest sparse point in the swept environment [m]
    link_energy: wp.array3d(dtype=float)  # (B, L, NUM_TERMS)
    energy: wp.array2d(dtype=float)  # (B, NUM_TERMS)
    gradient: wp.array2d(dtype=float)  # (B, 6 + d)


def state_fields() -> dict[str, type]:
    """Return the element type of each array of `State`, by name."""
    return {name: variable.type.dtype for name, variable in State.vars.items()}


@wp.func
def add_wrench(state: State, i: int, l: int, gradient: wp.vec3, p: wp.vec3):
    """Adds the gradient in the position of p, a point that moves with link l."""
    wp.atomic_add(state.force, i, l, gradient)
    wp.atomic_add(state.moment, i, l, wp.cross(p, gradient))
