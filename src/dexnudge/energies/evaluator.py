"""Energy and gradient of a batch of hands in one scene, by the fused kernel."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.energies import hand_kernel
from dexnudge.energies.hand_kernel import contacts, energies, kinematics, reduce_gradient
from dexnudge.energies.hand_model import build_hand_model
from dexnudge.energies.kernel_structs import NUM_TERMS, EnergyWeights, State
from dexnudge.energies.weights import OUTSIDE_KERNEL, TermWeights
from dexnudge.geometry.warp_runtime import WarpStruct, wp
from dexnudge.hands.hand import Hand

SMALLEST_PART = 8  # hands; fewer per thread cost more in launching than they save


@dataclass
class HandPose:
    """A batch of hand configurations as the optimiser moves them; working frame.

    `translation` [m] and `rotation` of the palm, `joint_angles` [rad].
    """

    translation: Float[Tensor, "batch 3"]
    rotation: Float[Tensor, "batch 3 3"]
    joint_angles: Float[Tensor, "batch joint"]


@dataclass
class HandEnergy:
    """Evaluates all terms for a fixed batch size; its arrays are allocated once.

    Attributes (views into what the kernel writes, overwritten by the next call):
        energy: (batch, NUM_TERMS), weighted.
        gradient: (batch, 6 + d) in translation [1/m], rotation vector in the working frame [1/rad], joint angles.
        contact_distance, contact_point, contact_normal: per link, its point nearest to the object; distance 1e6 where
            the link is far from the object and no contact is wanted of it.
        active: (batch,) to be set: a hand with 0 is skipped and keeps the results of its last evaluation.
        depth: (batch, link, 3) deepest guiding point in environment, object and other links [m]. swept_depth: (batch, link)
            the same in the environment swept along the motion; 0 where that term is off.
    """

    hand: Hand
    scene: WarpStruct
    batch: int
    weights: TermWeights = field(default_factory=TermWeights)
    device: str = "cpu"

    def __post_init__(self) -> None:
        links, joints = len(self.hand.link_names), self.hand.num_joints
        self._model = build_hand_model(self.hand, device=self.device)
        wp.load_module(hand_kernel, device=self.device)  # compiling is not safe from several threads
        self._tensors = {
            name: torch.zeros(shape, dtype=torch.float32, device=self.device)
            for name, shape in {
                "root_translation": (self.batch, 3),
                "root_rotation": (self.batch, 3, 3),
                "joint_angles": (self.batch, joints),
                "contact_weight": (self.batch, links),
                "target": (self.batch, links, 3),
                "target_weight": (self.batch, links),
                "link_rotation": (self.batch, links, 3, 3),
                "link_translation": (self.batch, links, 3),
                "link_centre": (self.batch, links, 3),
                "force": (self.batch, links, 3),
                "moment": (self.batch, links, 3),
                "extra_force": (self.batch, links, 3),
                "contact_point": (self.batch, links, 3),
                "contact_distance": (self.batch, links),
                "contact_normal": (self.batch, links, 3),
                "depth": (self.batch, links, 3),
                "swept_depth": (self.batch, links),
                "link_energy": (self.batch, links, NUM_TERMS),
                "energy": (self.batch, NUM_TERMS),
                "gradient": (self.batch, 6 + joints),
            }.items()
        }
        vectors = ["root_translation", "target", "link_translation", "link_centre", "force", "moment", "extra_force"]
        vectors += ["contact_point", "contact_normal", "depth"]
        types = dict.fromkeys(vectors, wp.vec3) | {
            "active": wp.int32,
            "root_rotation": wp.mat33,
            "link_rotation": wp.mat33,
        }
        self._tensors["active"] = torch.ones(self.batch, dtype=torch.int32, device=self.device)
        self._state = State()
        for name, tensor in self._tensors.items():
            setattr(self._state, name, wp.from_torch(tensor, dtype=types.get(name, wp.float32)))
        self.set_weights(self.weights)
        tips = self.hand.fingertip_indices
        self._fingertips = wp.array(tips, dtype=wp.int32, device=self.device)
        # A launch on the CPU holds one thread and releases the interpreter.
        parts = min(torch.get_num_threads(), max(1, self.batch // SMALLEST_PART)) if self.device == "cpu" else 1
        bounds = [round(self.batch * part / parts) for part in range(parts + 1)]
        self._parts = [(low, high - low) for low, high in pairwise(bounds)]
        self._pool = ThreadPoolExecutor(parts) if parts > 1 else None

    def __getattr__(self, name: str) -> Tensor:
        tensors = self.__dict__.get("_tensors", {})
        if name in tensors:
            return tensors[name]
        raise AttributeError(name)

    def set_weights(self, weights: TermWeights) -> None:
        """Replaces the weights of all terms."""
        self.weights = weights
        self._kernel_weights = EnergyWeights()
        for name, value in vars(weights).items():
            if name not in OUTSIDE_KERNEL:
                setattr(self._kernel_weights, name, float(value))

    def __call__(self, pose: HandPose) -> Float[Tensor, " batch"]:
        """Total energy of each hand; the attributes hold its parts and its gradient."""
        self._place(pose)
        self._in_parts(self._evaluate)
        return self._tensors["energy"].sum(dim=1)

    def find_fingertip_contacts(self, pose: HandPose) -> None:
        """Sets contact_distance, contact_point and contact_normal of all fingertips, and no energy: a third of the time."""
        self._place(pose)
        self._in_parts(self._find_contacts)

    def _place(self, pose: HandPose) -> None:
        self._tensors["root_translation"].copy_(pose.translation)
        self._tensors["root_rotation"].copy_(pose.rotation)
        self._tensors["joint_angles"].copy_(pose.joint_angles)

    def _in_parts(self, launch: Callable[[tuple[int, int]], None]) -> None:
        if self._pool is None:
            launch(self._parts[0])
        else:
            list(self._pool.map(launch, self._parts))

    def _evaluate(self, part: tuple[int, int]) -> None:
        first, count = part
        links = len(self.hand.link_names)
        wp.launch(kinematics, dim=count, inputs=[self._model, self._state, first], device=self.device)
        inputs = [self._model, self.scene, self._kernel_weights, self._state, first]
        wp.launch(energies, dim=(count, links), inputs=inputs, device=self.device)
        wp.launch(reduce_gradient, dim=count, inputs=[self._model, self._state, first], device=self.device)

    def _find_contacts(self, part: tuple[int, int]) -> None:
        first, count = part
        wp.launch(kinematics, dim=count, inputs=[self._model, self._state, first], device=self.device)
        inputs = [self._model, self.scene, self._kernel_weights, self._state, self._fingertips, first]
        wp.launch(contacts, dim=(count, len(self._fingertips)), inputs=inputs, device=self.device)
