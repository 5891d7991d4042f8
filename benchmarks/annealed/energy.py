"""DexGraspNet's grasp energy with its gradient, for any hand (Wang et al., ICRA 2023, and its public code).

    E = E_fc + 100 E_dis + 100 E_pen + 10 E_spen + E_joints

E_fc = |sum n_i|^2 + |sum (p_i - c) x n_i|^2 over four contacts p_i [m] with the object's unit normals n_i there,
E_dis = sum |distance(p_i)|, E_pen = sum over points of the object of their depth inside the hand, E_spen = sum over ordered
pairs of keypoints of max(0, 0.02 - their distance). What differs from the original:

- Contact candidates and keypoints are not authored by hand: candidates are ten points, as many as theirs, spread over the
  pad of each last link, keypoints the middles of cells of about 2 cm that fill the links. Pairs of keypoints are those of
  links that must not touch; the others contribute a constant or next to it.
- Links are their collision meshes (theirs: capsules and a palm mesh), read from grids of 1.5 to 3 mm; the forearm counts.
- Distance and normal of a contact farther than 8 mm from the object's box are those towards the box.
- About 2000 object points are spread by Poisson discs (theirs: farthest points).
- Limits and couplings hold by construction, so that E_joints is zero.
"""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from annealed import kernel
from annealed.kernel import AnnealModel, contacts, crowding, penetrations
from annealed.starts import farthest_points
from jaxtyping import Float, Int
from torch import Tensor

from dexnudge.energies.descent import HandPose
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.hand_kernel import kinematics, reduce_gradient
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_points import surface_points
from dexnudge.geometry.warp_runtime import WarpStruct, wp
from dexnudge.hands.hand import Hand

OBJECT_POINTS = 2000  # of the object that are tested against the hand
POINTS_PER_SPACING = 1.1  # points of `surface_points` per (area / spacing^2)
PAD_NORMAL = 0.7  # smallest part of a surface normal along the direction in which a fingertip flexes
PAD_CANDIDATES = 10  # contact candidates on each last link
KEYPOINT_CELL = 0.02  # [m]


@dataclass(frozen=True)
class AnnealWeights:
    """Weights of the terms; distances in metres. `keypoint_distance`: at which E_spen begins [m]."""

    force_closure: float = 1.0
    distance: float = 100.0
    penetration: float = 100.0
    self_penetration: float = 10.0
    keypoint_distance: float = 0.02


class AnnealEnergy(HandEnergy):
    """Evaluates DexGraspNet's energy; `contact_index` (batch, contacts) says which candidates touch.

    `energy` and `gradient` are as in `HandEnergy`; the columns of `energy` are E_fc, E_pen, E_spen, E_dis, weighted, and 0.
    """

    def __init__(
        self,
        hand: Hand,
        fields: WarpStruct,
        object_mesh: trimesh.Trimesh,
        centre_of_mass: Float[np.ndarray, " 3"],
        *,
        contact_index: Int[np.ndarray, "batch contact"],
        weights: AnnealWeights,
    ) -> None:
        super().__init__(hand, fields, len(contact_index))
        wp.load_module(kernel, device=self.device)
        self._chosen = torch.as_tensor(contact_index, dtype=torch.int32)
        self._chosen_array = wp.from_torch(self._chosen)
        candidate, link = contact_candidates(hand)
        keypoints = [link_keypoints(hand, index) for index in range(len(hand.link_names))]
        spacing = float(np.sqrt(POINTS_PER_SPACING * object_mesh.area / OBJECT_POINTS))
        model = AnnealModel()
        model.object_points = _vectors(surface_points(object_mesh, spacing=spacing).points)
        model.keypoints = _vectors(np.concatenate(keypoints))
        model.first_keypoint = wp.array(np.cumsum([0, *map(len, keypoints)]).astype(np.int32), dtype=int)
        model.candidate = _vectors(candidate)
        model.candidate_link = wp.array(link.astype(np.int32), dtype=int)
        model.centre = wp.vec3(*(float(value) for value in centre_of_mass))
        for name, value in vars(weights).items():
            setattr(model, name, float(value))
        self._anneal_model = model

    def choose(self, contact_index: Int[np.ndarray, "batch contact"]) -> None:
        """Replaces the candidates that touch."""
        self._chosen.copy_(torch.from_numpy(contact_index))

    def _evaluate(self, rows: wp.array) -> None:
        count, links = len(rows), len(self.hand.link_names)
        hand, scene, model, state = self.model, self.scene, self._anneal_model, self.state
        wp.launch(kinematics, dim=count, inputs=[hand, state, rows])
        wp.launch(penetrations, dim=(count, links), inputs=[hand, scene, model, state, rows])
        wp.launch(crowding, dim=(count, links), inputs=[hand, model, state, rows])
        wp.launch(contacts, dim=count, inputs=[scene, model, state, self._chosen_array, rows])
        wp.launch(reduce_gradient, dim=count, inputs=[hand, state, rows])

    def evaluate(
        self, pose: HandPose, contact_index: Int[np.ndarray, "batch contact"]
    ) -> tuple[Float[Tensor, " batch"], Float[Tensor, "batch tangent"]]:
        """(energy, gradient) of each hand with these candidates; copies."""
        self.choose(contact_index)
        return self(pose), self.gradient.clone()


def contact_candidates(hand: Hand) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """(points in their link's frame [m], their links) on the side of each last link that closes when the digit flexes."""
    sparse = hand.sparse_points
    points, links = [], []
    for name, keypoint in zip(hand.fingertip_links, hand.fingertip_keypoints, strict=True):
        link = hand.link_names.index(name)
        joint = hand.joints[link]
        assert joint is not None
        flexing = 1.0
        if joint.index is not None:
            closes_upwards = hand.upper[joint.index] >= -hand.lower[joint.index]
            flexing = float(np.sign(joint.multiplier)) * (1.0 if closes_upwards else -1.0)
        pad = flexing * np.cross(joint.axis, keypoint)
        pad /= np.linalg.norm(pad)
        outer = (sparse.normals @ pad > PAD_NORMAL) & (sparse.points @ pad > 0)  # meshes may have an inside as well
        spread = farthest_points(sparse.points[(sparse.link == link) & outer], PAD_CANDIDATES)
        points.append(spread)
        links.append(np.full(len(spread), link))
    return np.concatenate(points), np.concatenate(links)


def link_keypoints(hand: Hand, link: int) -> Float[np.ndarray, "n 3"]:
    """Middles of equal cells of about 2 cm of the link's box that lie inside the link [m]; none for the base."""
    mesh = hand.link_meshes[link]
    if len(mesh.faces) == 0 or hand.link_names[link] == hand.base_link:
        return np.zeros((0, 3))
    lower, upper = mesh.bounds
    counts = np.maximum(np.round((upper - lower) / KEYPOINT_CELL).astype(int), 1)
    cells = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    middles = lower + (cells + 0.5) / counts * (upper - lower)
    return middles[ExactDistance(mesh)(middles).distance < 0]


def _vectors(points: Float[np.ndarray, "n 3"]) -> wp.array:
    return wp.array(points.astype(np.float32), dtype=wp.vec3)
