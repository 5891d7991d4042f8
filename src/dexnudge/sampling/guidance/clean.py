"""A few steps of descent on the clean estimate itself, with Adam moments that live through the whole denoising.

x0_hat is turned into a hand, the hand descends the scene's energy on its own manifold (translation, SO(3), joints within
limits and couplings), and DDIM goes on from the corrected estimate. Nothing is differentiated through the network (as in
MPGD and in TFG's mean guidance), the steps shrink where almost nothing is wrong, and their size does not depend on the other
samples of the batch. The moments carry over from one denoising step to the next (as in Adam-guided sampling), because the
gradients of consecutive steps stay correlated.
"""

from dataclasses import dataclass, field

from jaxtyping import Float
from torch import Tensor

from dexnudge.energies.descent import HandDescent, StepSizes, configuration_from_pose, pose_from_configuration
from dexnudge.sampling.guidance.rule import ReverseStep, gradient_at_clean_estimate, unit


@dataclass(frozen=True)
class CleanGradient:
    """Strength s in the normalised space of x, the same in every step."""

    strength: float = 0.05

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """Return x_{t-1} from the corrected clean estimate."""
        x0_hat = step.clean_estimate()
        _, gradient = gradient_at_clean_estimate(step, x0_hat)
        return step.ddim(x0_hat - self.strength * unit(gradient))


@dataclass
class CleanDescent:
    """State of one denoising run: create one per call of the sampler.

    inner_steps: of descent in each denoising step. begin: share of signal (alpha bar) from which on guidance acts; before,
    the estimate is an average over all modes and means nothing. negligible: energy [m^2] under which the steps shrink.
    """

    inner_steps: int = 6
    begin: float = 0.02
    negligible: float = 1.0e-4
    step_sizes: StepSizes = StepSizes(translation=0.008, rotation=0.06, joints=0.06)
    _descent: HandDescent | None = field(default=None, repr=False)

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """Return x_{t-1} from the corrected clean estimate."""
        x0_hat = step.clean_estimate()
        return step.ddim(self._correct(step, x0_hat) if step.alpha_bar >= self.begin else x0_hat)

    def _correct(self, step: ReverseStep, x0_hat: Float[Tensor, "batch dimension"]) -> Float[Tensor, "batch dimension"]:
        q = step.prior.normaliser.denormalise(x0_hat)
        step.set_active_contacts(q)
        if self._descent is None:
            self._descent = HandDescent(step.hand, len(q), steps=self.step_sizes, tied=True, device=step.energy.device)
        pose = pose_from_configuration(q)
        for _ in range(self.inner_steps):
            energy = (step.energy(pose) + step.pull_to_balance())[:, None]
            # Adam alone would take full steps on a hand that is almost right.
            pose = self._descent.step(pose, step.energy.gradient, scale=(energy / (energy + self.negligible)).sqrt())
        return step.prior.normaliser.normalise(configuration_from_pose(pose))
