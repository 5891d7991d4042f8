"""Energy and gradient of a batch of hands in one scene: the fused kernel's terms, and the user's beside them."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import torch
from jaxtyping import Float, Int
from torch import Tensor

from dexnudge.energies import hand_kernel
from dexnudge.energies.descent import HandPose
from dexnudge.energies.force_residual import Contacts, ForceResidual, SlidingBalance
from dexnudge.energies.hand_kernel import contacts, energies, kinematics, reduce_gradient
from dexnudge.energies.kernel_inputs import build_hand_model
from dexnudge.energies.kernel_structs import NUM_TERMS, EnergyWeights, State, state_fields
from dexnudge.energies.terms import OUTSIDE_KERNEL, TermEnergy, TermWeights
from dexnudge.geometry.warp_runtime import WarpStruct, wp
from dexnudge.hands.hand import Hand

FROM_ENVIRONMENT = ("clearance_environment", "clearance_base")  # weights that are distances from it
SMALLEST_PART = 8  # hands; fewer per thread cost more in launching than they save


class HandEnergy:
    """Evaluates all terms for a fixed batch size; its arrays are allocated once.

    Args:
        hand: what is configured.
        scene: fields of the scene, see `build_scene_fields`; may be replaced by others between calls.
        batch: number of hands.
        weights: of the kernel's terms; the defaults of `TermWeights` if left out.
        device: of Warp and torch.
        terms: the user's terms; may be replaced, or switched off by None, between calls.
        balances: what the contacts of the fingertips must do, for `balance_forces`.
        clearance: distance that the hand keeps from the environment [m]; the clearances of the weights begin there.

    Attributes (overwritten by the next call; `active`, `contact_weight`, `target` and `target_weight` are to be set):
        energy: of each kernel term, weighted. term_energy: of the user's terms together.
        gradient: in translation [1/m], rotation vector in the working frame [1/rad], joint angles; of all terms.
        contact_weight: share of the contact term that each link feels. contact_distance, contact_point, contact_normal: of
            its point nearest to the object; distance 1e6 where the link is far and no contact is wanted of it.
        target, target_weight: see `TermWeights`.
        force: the balance and its residual, None without; it pulls the contacts by `extra_force`.
        active: a hand with 0 is skipped and keeps the results of its last evaluation.
        depth: deepest guiding point in the environment grown by `clearance`, in object and other links [m]. swept_depth: the
            same in the environment swept along the motion; 0 where that term is off.
    """

    active: Int[Tensor, " batch"]
    root_translation: Float[Tensor, "batch 3"]
    root_rotation: Float[Tensor, "batch 3 3"]
    joint_angles: Float[Tensor, "batch joint"]
    contact_weight: Float[Tensor, "batch link"]
    target: Float[Tensor, "batch link 3"]
    target_weight: Float[Tensor, "batch link"]
    link_rotation: Float[Tensor, "batch link 3 3"]
    link_translation: Float[Tensor, "batch link 3"]
    extra_force: Float[Tensor, "batch link 3"]
    contact_point: Float[Tensor, "batch link 3"]
    contact_distance: Float[Tensor, "batch link"]
    contact_normal: Float[Tensor, "batch link 3"]
    depth: Float[Tensor, "batch link 3"]
    swept_depth: Float[Tensor, "batch link"]
    energy: Float[Tensor, "batch term"]
    gradient: Float[Tensor, "batch tangent"]

    def __init__(
        self,
        hand: Hand,
        scene: WarpStruct,
        batch: int,
        weights: TermWeights | None = None,
        *,
        device: str = "cpu",
        terms: TermEnergy | None = None,
        balances: Sequence[SlidingBalance] = (),
        clearance: float = 0.0,
    ) -> None:
        self.hand, self.scene, self.batch, self.device, self.terms = hand, scene, batch, device, terms
        self._clearance = clearance
        self.model = build_hand_model(hand, device=device)
        wp.load_module(hand_kernel, device=device)  # compiling is not safe from several threads
        links, joints = len(hand.link_names), hand.num_joints
        own_shape = {"joint_angles": (joints,), "energy": (NUM_TERMS,), "link_energy": (links, NUM_TERMS)}
        own_shape |= {"gradient": (6 + joints,), "active": (), "root_translation": (), "root_rotation": ()}
        self.state = State()
        for name, kind in state_fields().items():
            inner = {wp.vec3: (3,), wp.mat33: (3, 3)}.get(kind, ())
            shape = (batch, *own_shape.get(name, (links,)), *inner)
            tensor = torch.zeros(shape, dtype=torch.int32 if kind is wp.int32 else torch.float32, device=device)
            setattr(self, name, tensor)
            setattr(self.state, name, wp.from_torch(tensor, dtype=kind))
        self.active.fill_(1)
        self._tips = hand.fingertip_indices
        self._fingertips = wp.array(self._tips, dtype=wp.int32, device=device)
        self.force = ForceResidual(balances, self.active, len(self._tips), device=device) if balances else None
        self.term_energy = torch.zeros(batch, device=device)
        self.set_weights(weights or TermWeights())
        self._every_row = wp.array(range(batch), dtype=wp.int32, device=device)
        # A launch on the CPU holds one thread and releases the interpreter.
        parts = min(torch.get_num_threads(), max(1, batch // SMALLEST_PART)) if device == "cpu" else 1
        bounds = [round(batch * part / parts) for part in range(parts + 1)]
        self._parts = [wp.array(range(*part), dtype=wp.int32, device=device) for part in pairwise(bounds)]
        self._pool = ThreadPoolExecutor(parts) if parts > 1 else None

    def set_weights(self, weights: TermWeights) -> None:
        """Replace the weights of the kernel's terms."""
        self.weights = weights
        self._kernel_weights = EnergyWeights()
        for name, value in vars(weights).items():
            if name not in OUTSIDE_KERNEL:
                kept = self._clearance if name in FROM_ENVIRONMENT else 0.0
                setattr(self._kernel_weights, name, float(value) + kept)
        self._kernel_weights.kept_clear = self._clearance

    def __call__(self, pose: HandPose) -> Float[Tensor, " batch"]:
        """Return the total energy of each hand; the attributes hold its parts and its gradient.

        Raises:
            InputError: a term of the user's that fails, see `TermEnergy`.
        """
        self.place(pose)
        self._in_parts(self._evaluate)
        total = self.energy.sum(dim=1)
        if self.terms is None:
            return total
        # The kernel has just written the gradients of the active hands: only theirs lack the terms'.
        if len(rows := self.active.nonzero()[:, 0]):
            poses = HandPose(pose.translation[rows], pose.rotation[rows], pose.joint_angles[rows])
            self.term_energy[rows], slope = self.terms(poses)
            self.gradient[rows] += slope
        return total + self.term_energy

    def balance_forces(self, *, sweeps: int) -> None:
        """Solve `force` at the wanted contacts of the last evaluation; the next ones pull them to where they balance."""
        for launch in self.balance_launches(self._every_row, sweeps=sweeps):
            launch.launch()

    def find_fingertip_contacts(self, pose: HandPose) -> None:
        """Set contact_distance, contact_point and contact_normal of all fingertips, and no energy: a third of the time."""
        self.place(pose)
        self._in_parts(self._find_contacts)

    def place(self, pose: HandPose) -> None:
        """Set the pose that is evaluated next."""
        self.root_translation.copy_(pose.translation)
        self.root_rotation.copy_(pose.rotation)
        self.joint_angles.copy_(pose.joint_angles)

    @property
    def pose(self) -> HandPose:
        """The pose of the last evaluation, or where a kernel has moved it since; not copied."""
        return HandPose(self.root_translation, self.root_rotation, self.joint_angles)

    def energy_launch(self, rows: wp.array, scene: WarpStruct) -> wp.Launch:
        """Return the launch that finds all terms and wrenches of the hands `rows`, whose links are placed already."""
        inputs = [self.model, scene, self._kernel_weights, self.state, rows]
        dim = (len(rows), len(self.hand.link_names))
        return wp.launch(energies, dim=dim, inputs=inputs, device=self.device, record_cmd=True)

    def balance_launches(self, rows: wp.array, *, sweeps: int) -> list[wp.Launch]:
        """Return the launches of `balance_forces` for the hands `rows`; none without a balance."""
        if self.force is None:
            return []
        contacts = Contacts()
        contacts.links, contacts.wanted = self._fingertips, self.state.contact_weight
        contacts.points, contacts.normals = self.state.contact_point, self.state.contact_normal
        contacts.pull, contacts.pull_weight = self.state.extra_force, self.weights.force
        return self.force.launches(contacts, rows, sweeps=sweeps)

    def _in_parts(self, launch: Callable[[wp.array], None]) -> None:
        if self._pool is None:
            launch(self._parts[0])
        else:
            list(self._pool.map(launch, self._parts))

    def _evaluate(self, rows: wp.array) -> None:
        inputs = [self.model, self.state, rows]
        wp.launch(kinematics, dim=len(rows), inputs=inputs, device=self.device)
        self.energy_launch(rows, self.scene).launch()
        wp.launch(reduce_gradient, dim=len(rows), inputs=inputs, device=self.device)

    def _find_contacts(self, rows: wp.array) -> None:
        wp.launch(kinematics, dim=len(rows), inputs=[self.model, self.state, rows], device=self.device)
        inputs = [self.model, self.scene, self._kernel_weights, self.state, self._fingertips, rows]
        wp.launch(contacts, dim=(len(rows), len(self._fingertips)), inputs=inputs, device=self.device)
