"""A scene made ready for sampling: its canonical frame, its distance fields and its force balance."""

import pickle
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from torch import Tensor

from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.force_residual import SlidingBalance, support_wrenches
from dexnudge.energies.kernel_inputs import build_guided_fields
from dexnudge.energies.terms import EnergyTerm, TermEnergy, TermWeights
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_points import object_cloud
from dexnudge.geometry.transforms import canonical_frame, transform_configurations
from dexnudge.geometry.warp_runtime import WarpStruct
from dexnudge.hands.hand import Hand
from dexnudge.jobs.processes import release_memory
from dexnudge.mechanics.friction_cone import ACROSS
from dexnudge.mechanics.sliding_task import hardest_task
from dexnudge.mechanics.support_forces import support_forces
from dexnudge.planning.object_path import leans, pulled, station
from dexnudge.sampling.helpful_places import HelpfulPlaces, helpful_places
from dexnudge.scenes.motion import Twist
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts

# Cosines of the object's outward normal and the motion: above the first a contact pushes back more than friction pulls on;
# up to the second a place is worth going to.
FACING_MOTION, PUSHABLE = 0.5, 0.2
ON_TOP = 0.5  # z of the object's outward normal above which a contact presses it down
TIP_RADIUS = 0.008  # [m] of a fingertip, from its keypoint to the surface that it touches
ROOM = 0.006  # [m] that the environment must leave around the keypoint; fingertips are flat in front
MESHES = ("object_mesh", "environment_mesh")  # of a scene
ABOUT = ("name", "parameters", "seed")  # what says where it came from
FRICTION_MARGIN = 1.6  # factor on friction_environment that the contacts are asked to overcome: above robust's 1.5
RELEASED_AFTER = 16  # scenes that were made ready
PINCHING = 0.6  # of the hand's friction, with which fingers should hold what they pull upright


@dataclass(frozen=True)
class PushableSurface:
    """Where a fingertip can push the object: places for its keypoint, frame C; there may be none.

    Attributes:
        twists: with which the parts of the motion begin, of the object as it lies. places: [m], a fingertip's radius above
            the object's surface. press_moves: whether pressing from above can move the object.
    """

    twists: tuple[Twist, ...]
    places: Float[Tensor, "place 3"]
    press_moves: bool

    def to(self, device: str) -> "PushableSurface":
        """Return the same on another device."""
        return replace(self, places=self.places.to(device))


def facing(
    twists: Iterable[Twist], points: Float[Tensor, "*batch 3"], normals: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch"]:
    """Return the greatest cosine between the object's outward normal at a point and the velocity of that point."""
    cosines = [(normals * _direction(twist, points)).sum(dim=-1) for twist in twists]
    return torch.stack(cosines).amax(dim=0)


def _direction(twist: Twist, points: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """`Twist.direction`, where the points lie."""
    linear, angular = (torch.from_numpy(each).to(points) for each in (twist.linear, twist.angular))
    if not twist.angular.any():
        return linear.expand_as(points)
    return torch.nn.functional.normalize(linear + torch.linalg.cross(angular.expand_as(points), points), dim=-1)


def pushable_surface(
    places: Float[Tensor, "place 3"], surface: Float[Tensor, "place 6"], twists: Sequence[Twist], *, press_moves: bool
) -> PushableSurface:
    """Return where on the object a fingertip can push, of where it fits (see `places_with_room`); one frame.

    twists, press_moves: as in `PushableSurface`.
    """
    useful = facing(twists, surface[:, :3], surface[:, 3:]) < PUSHABLE
    if not press_moves:
        useful &= surface[:, 5] <= ON_TOP
    return PushableSurface(tuple(twists), places[useful], press_moves)


def places_with_room(
    cloud: Float[Tensor, "point 6"], environment: ExactDistance, *, clearance: float
) -> tuple[Float[Tensor, "place 3"], Float[Tensor, "place 6"]]:
    """Return where a fingertip's keypoint fits that touches the object [m], and the points and normals that it touches.

    cloud: points [m] and outward normals of the object. clearance: that the fingertip keeps from the environment [m].
    """
    places = cloud[:, :3] + TIP_RADIUS * cloud[:, 3:]
    room = torch.from_numpy(environment.distances(places.double().numpy())) > ROOM + clearance
    return places[room], cloud[room]


@dataclass(frozen=True)
class SamplingProblem:
    """What a sampler needs to know of a scene, in the canonical frame C (x the motion, z up).

    Attributes:
        T_world_canonical: frame C in the world.
        fields: distance grids of object and environment for the fused kernel.
        guiding_fields: the same, with occluded space as solid (see `occlusion`).
        balances: the force balances to reach, where the parts of the motion begin; none when nothing supports the object or
            its supports block the motion.
        cloud: (1024, 6) points [m] and outward normals of the object.
        pushable: where on the object a fingertip can push for the motion.
        helpful: where one more fingertip would help; None where the object only slides, for which one is mostly enough.
        object_mesh: in frame C.
        terms: the user's, which every energy of this problem holds beside the kernel's.
        device: where the fields lie, and hands are drawn and projected; `cloud` and `balances` are on the CPU.
    """

    scene: Scene
    T_world_canonical: Float[np.ndarray, "4 4"]
    fields: WarpStruct
    guiding_fields: WarpStruct
    balances: tuple[SlidingBalance, ...]
    cloud: Float[Tensor, "point 6"]
    pushable: PushableSurface
    helpful: HelpfulPlaces | None
    object_mesh: trimesh.Trimesh
    terms: tuple[EnergyTerm, ...] = ()
    device: str = "cpu"

    def hand_energy(self, hand: Hand, batch: int, weights: TermWeights) -> HandEnergy:
        """Return the energy that guides: what cannot be seen from the object counts as solid."""
        terms = None
        if self.terms:
            terms = TermEnergy(self.terms, hand, self.scene, self.T_world_canonical, device=self.device)
        return HandEnergy(
            hand,
            self.guiding_fields,
            batch,
            weights,
            device=self.device,
            terms=terms,
            balances=self.balances,
            clearance=self.scene.clearance,
        )

    def to_world(self, q: Float[Tensor, "n coordinates"]) -> Float[np.ndarray, "n coordinates"]:
        """Return configurations of frame C in the world, as they are written to files."""
        return transform_configurations(self.T_world_canonical, q.double().cpu().numpy()).astype(np.float32)


def prepare(scene: Scene, *, device: str = "cpu") -> SamplingProblem:
    """Make a scene ready: fields, balances and pushable surface in its canonical frame."""
    T_world_canonical = canonical_frame(scene.object_in_world(), scene.motion)
    T_canonical_world = np.linalg.inv(T_world_canonical)
    object_mesh = scene.object_in_world()
    object_mesh.apply_transform(T_canonical_world)
    environment_mesh = scene.environment_mesh.copy()
    environment_mesh.apply_transform(T_canonical_world)
    motion = scene.object_motion.moved(T_canonical_world)
    plain, guiding = build_guided_fields(object_mesh, environment_mesh, device=device, motion=motion)
    cloud = object_cloud(object_mesh)
    environment, task = ExactDistance(environment_mesh, device=device), hardest_task(scene)
    balances = _balances(scene, T_canonical_world)
    places, surface = places_with_room(cloud, environment, clearance=scene.clearance)
    press_moves = task.friction_hand > task.friction_environment
    pushable = pushable_surface(places, surface, motion.beginning_twists, press_moves=press_moves)
    if pulled(scene):  # by a pinch, on its sides
        beside = surface[:, 3].abs() < ACROSS
        places, surface = places[beside], surface[beside]
    return SamplingProblem(
        scene=scene,
        T_world_canonical=T_world_canonical,
        fields=plain,
        guiding_fields=guiding,
        balances=balances,
        cloud=cloud,
        pushable=pushable.to(device),
        helpful=helpful_places(places, surface, balances).to(device) if scene.turn and balances else None,
        object_mesh=object_mesh,
        device=device,
    )


class PreparedScene:
    """The scene that was made ready last, for callers that draw from one scene again and again.

    Memory stays flat over many scenes: now and then what is left of earlier ones is released.
    """

    def __init__(self, device: str) -> None:
        self.device = device
        self._content, self._made = b"", 0
        self._problem: SamplingProblem | None = None

    def __call__(self, scene: Scene) -> SamplingProblem:
        """Return a scene made ready: what was made before, where its meshes are the same objects and nothing has changed."""
        content, known = _content(scene), self._problem
        same = known is not None and all(getattr(known.scene, name) is getattr(scene, name) for name in MESHES)
        if known is None or not same or content != self._content:
            known = self._problem = prepare(scene, device=self.device)
            self._content, self._made = content, self._made + 1
            if self._made % RELEASED_AFTER == 0:
                release_memory()
        return replace(known, scene=scene)


def _content(scene: Scene) -> bytes:
    """Return all of a scene that may change while its meshes stay the same objects, their vertices and faces included."""
    names = [each.name for each in fields(scene) if each.name not in (*MESHES, *ABOUT)]
    return pickle.dumps([*(hash(getattr(scene, name)) for name in MESHES), *(getattr(scene, name) for name in names)])


def _balances(scene: Scene, T_canonical_world: Float[np.ndarray, "4 4"]) -> tuple[SlidingBalance, ...]:
    """Return the balances to reach, as the hand sees them that is carried along; frame C.

    Those where each part of the motion begins. Of an object that is `pulled` those where the slide ends in
    place of where it begins, in worlds that lean to either side, and with less of the hand's friction.
    """
    motion, found = scene.object_motion, []
    upright, hand_friction = np.eye(3), 1.0
    places = [(way, upright) for way in motion.beginnings]
    if leaning := leans(scene):
        places, hand_friction = [(0.0, upright), *((motion.length, T[:3, :3]) for T in leaning)], PINCHING
    for way, lean in places:
        there = scene.carried(way) if way else scene
        T = T_canonical_world @ np.linalg.inv(motion.displacement(way)) if way else T_canonical_world
        supports, task = station(scene, way).supports if leaning else support_contacts(there), hardest_task(there)
        normals, friction, support, blocked = support_forces(supports, task)
        if blocked or not len(support):
            return ()
        rotation, translation = T[:3, :3], T[:3, 3]
        centre = _tensor(rotation @ task.centre + translation)
        forces = normals + FRICTION_MARGIN * friction
        wrenches = support_wrenches(
            _tensor(supports.points[support] @ rotation.T + translation),
            _tensor(forces @ rotation.T),
            centre,
            task.half_length,
        )
        balance = SlidingBalance(
            centre_of_mass=centre,
            half_length=task.half_length,
            support_wrenches=wrenches,
            gravity=_tensor(rotation @ lean.T @ np.asarray([0.0, 0.0, -1.0])),
            friction_hand=hand_friction * task.friction_hand,
            max_normal=task.max_normal_force / task.weight,
        )
        found.append(balance)
    return tuple(found)


def _tensor(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.asarray(values)).float()
