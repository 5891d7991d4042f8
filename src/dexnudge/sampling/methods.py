"""Named ways to draw configurations: ours, the paper's, and the baselines, all with the same data, checks and projection."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace

from dexnudge.energies.weights import TermWeights
from dexnudge.errors import UnknownNameError, did_you_mean
from dexnudge.sampling.denoise import DenoisingConfig
from dexnudge.sampling.guidance.clean import CleanDescent, CleanGradient
from dexnudge.sampling.guidance.paper import PaperGuidance, unguided
from dexnudge.sampling.guidance.rule import GuidanceRule
from dexnudge.sampling.guidance.spherical import CleanSpherical, Resampled, SphericalGuidance
from dexnudge.sampling.projection import ProjectionConfig

GUIDING_WEIGHTS = TermWeights(contact=6.0, sweep=1.0, base=1.0, clearance_base=0.010)
"""Of the energy that chooses among coarse hands and guides; that of the projection is `PROJECTION_WEIGHTS`."""


@dataclass(frozen=True)
class Method:
    """How configurations are drawn.

    Attributes:
        summary: one line for `--help` and reports.
        start: "prior" (reverse diffusion), "random" (no model) or "nearest" (stored poses of a dataset, no model).
        behaviour: class asked of the prior.
        make_rule: makes the guidance rule of one run; rules may keep state.
        denoising, projection: their configurations; projection None leaves the samples as they are.
    """

    summary: str
    start: str = "prior"
    behaviour: str = "non_prehensile"
    make_rule: Callable[[], GuidanceRule] = CleanSpherical
    denoising: DenoisingConfig = field(default_factory=lambda: DenoisingConfig(weights=GUIDING_WEIGHTS))
    projection: ProjectionConfig | None = field(default_factory=ProjectionConfig)

    def with_weights(self, changes: Mapping[str, float]) -> "Method":
        """The same with other weights and clearances, by their names in `TermWeights`, in guidance and projection alike.

        Raises:
            InputError: a value that is negative or not finite.
        """
        denoising = replace(self.denoising, weights=replace(self.denoising.weights, **changes))
        projection = self.projection
        if projection is not None:
            projection = replace(projection, weights=replace(projection.weights, **changes))
        return replace(self, denoising=denoising, projection=projection)

    def weights(self) -> dict[str, dict[str, float]]:
        """The weights and clearances of each stage that uses an energy, for reports."""
        stages = {} if self.start != "prior" else {"guidance": asdict(self.denoising.weights)}
        return stages if self.projection is None else {**stages, "projection": asdict(self.projection.weights)}


STEERED_NOISE = Method(
    "prior, each step's noise turned towards descent of the energy at the clean estimate, then projected",
    denoising=DenoisingConfig(num_inference_steps=30, weights=GUIDING_WEIGHTS),
)
COARSE_HANDS = replace(
    STEERED_NOISE,
    summary="the best of up to 32 coarse hands, denoised again while its clean estimate descends, then projected",
    make_rule=CleanDescent,
    denoising=DenoisingConfig(num_inference_steps=14, particles=32, weights=GUIDING_WEIGHTS),
)
METHODS: dict[str, Method] = {
    "steered_noise": STEERED_NOISE,
    "resampled": replace(
        STEERED_NOISE,
        summary="ours, with promising draws of a call taking the places of hopeless ones (SMC): no independent draws",
        make_rule=Resampled,
    ),
    "coarse_hands": COARSE_HANDS,
    "clean_descent": replace(
        COARSE_HANDS,
        summary="a few steps of descent on the clean estimate in each step, then projected",
        denoising=DenoisingConfig(weights=GUIDING_WEIGHTS),
    ),
    "guidance_only": replace(STEERED_NOISE, summary="ours without the projection", projection=None),
    "paper": Method("Eq. 5 as printed, then projected", make_rule=PaperGuidance),
    "paper_guidance_only": Method("Eq. 5 as printed, not projected", make_rule=PaperGuidance, projection=None),
    "spherical": Method("spherical-Gaussian guidance (DSG, eta 1), then projected", make_rule=SphericalGuidance),
    "clean_gradient": Method(
        "one gradient step on the clean estimate in each step (MPGD), then projected", make_rule=CleanGradient
    ),
    "best_of_32": replace(
        COARSE_HANDS,
        summary="the best of 32 coarse hands, not guided, projected",
        make_rule=lambda: unguided,
        denoising=replace(COARSE_HANDS.denoising, first_particles=32),
    ),
    "unguided": Method("the prior alone", make_rule=lambda: unguided, projection=None),
    "unguided_projection": Method("the prior alone, then projected", make_rule=lambda: unguided),
    "grasp_projection": Method(
        "asked for grasps, guided, then projected: what a grasp-only model would do", behaviour="grasp"
    ),
    "random_start_projection": Method("no model: a random hand around the object, then projected", start="random"),
    "nearest_pose": Method(
        "no model: stored hands of the training object that is most like this one, then projected", start="nearest"
    ),
}


def find_method(name: str) -> Method:
    """The method of that name; UnknownNameError that lists those that exist."""
    if name not in METHODS:
        raise UnknownNameError(
            f"unknown method {name!r}{did_you_mean(name, METHODS)}; expected one of {', '.join(METHODS)}"
        )
    return METHODS[name]
