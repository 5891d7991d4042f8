"""Named ways to draw configurations: the default, the paper's, and baselines, all with the same data and checks."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace

from jaxtyping import Float
from torch import Tensor

from dexnudge.energies.terms import TermWeights
from dexnudge.errors import InputError, UnknownNameError, did_you_mean
from dexnudge.plugins import attribute, call_foreign, load_plugin, plugin_names, plugin_title
from dexnudge.sampling.denoise import DenoisingConfig
from dexnudge.sampling.guidance import GuidanceRule, ReverseStep, unguided
from dexnudge.sampling.guidance_rules import (
    CleanDescent,
    CleanGradient,
    CleanSpherical,
    PaperGuidance,
    Resampled,
    SphericalGuidance,
)
from dexnudge.sampling.projection import ProjectionConfig

GUIDING_WEIGHTS = TermWeights(contact=6.0, sweep=1.0, base=1.0, clearance_base=0.010)
"""Of the energy that chooses among coarse hands and guides; the projection has `PROJECTION_WEIGHTS`."""
PLUGIN_KIND = "guidance rule"


@dataclass(frozen=True)
class Method:
    """How configurations are drawn.

    Attributes:
        summary: one line for help and reports.
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

    @property
    def hands_per_draw(self) -> int:
        """How many hands of one draw stand in a batch at once, at most."""
        config = self.denoising
        if self.start != "prior" or config.particles == 1:
            return 1
        return max(min(config.first_particles, config.particles), config.particles // 2)

    def with_weights(self, changes: Mapping[str, float]) -> "Method":
        """Return the same with other weights and clearances, by their names in `TermWeights`, in guidance and projection.

        Raises:
            InputError: a value that is negative or not finite.
        """
        denoising = replace(self.denoising, weights=replace(self.denoising.weights, **changes))
        projection = self.projection
        if projection is not None:
            projection = replace(projection, weights=replace(projection.weights, **changes))
        return replace(self, denoising=denoising, projection=projection)

    def weights(self) -> dict[str, dict[str, float]]:
        """Return the weights and clearances of each stage that uses an energy, for reports."""
        stages = {} if self.start != "prior" else {"guidance": asdict(self.denoising.weights)}
        return stages if self.projection is None else {**stages, "projection": asdict(self.projection.weights)}


STEERED_NOISE = Method(
    "prior, each step's noise turned towards descent of the energy at the clean estimate, then projected",
    denoising=DenoisingConfig(num_inference_steps=15, weights=GUIDING_WEIGHTS),
)
FIRST_ORDER = replace(STEERED_NOISE, denoising=replace(STEERED_NOISE.denoising, num_inference_steps=30))
"""For rules whose steps are of first order."""
COARSE_HANDS = replace(
    STEERED_NOISE,
    summary="the best of up to 32 coarse hands, denoised again while its clean estimate descends, then projected",
    make_rule=CleanDescent,
    denoising=DenoisingConfig(num_inference_steps=14, particles=32, weights=GUIDING_WEIGHTS),
)
METHODS: dict[str, Method] = {
    "steered_noise": STEERED_NOISE,
    "resampled": replace(
        FIRST_ORDER,
        summary="steered_noise, its draws resampled by their energy now and then (SMC): not independent",
        make_rule=Resampled,
    ),
    "coarse_hands": COARSE_HANDS,
    "clean_descent": replace(
        COARSE_HANDS,
        summary="a few steps of descent on the clean estimate in each step, then projected",
        denoising=DenoisingConfig(weights=GUIDING_WEIGHTS),
    ),
    "guidance_only": replace(STEERED_NOISE, summary="steered_noise without the projection", projection=None),
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
    """Return the method of that name: a built-in one, or one that an installed package brings.

    A package names in the entry-point group `dexnudge.guidance_rules` either a `Method`, or a class of `GuidanceRule` (any
    callable that makes a rule for one run); such a rule takes the place of the one of `steered_noise`, with twice its steps.

    Raises:
        UnknownNameError: no such method; the message lists those that exist.
        InputError: what a package brings fails at import, or is neither a method nor makes a rule.
    """
    if name in METHODS:
        return METHODS[name]
    brought = plugin_names(PLUGIN_KIND)
    if name not in brought:
        names = [*METHODS, *brought]
        raise UnknownNameError(
            f"unknown method {name!r}{did_you_mean(name, names)}; expected one of {', '.join(names)}"
        )
    found = load_plugin(PLUGIN_KIND, name)
    if isinstance(found, Method):
        return replace(found, make_rule=lambda: _ForeignRule(name, found.make_rule))
    if not callable(found):
        raise InputError(
            f"{plugin_title(PLUGIN_KIND, name)} is of type {type(found).__name__}; expected a `Method`, or a class whose "
            "objects are called with a `ReverseStep` and return x_{t-1}; mend the package's entry point"
        )
    said = attribute(plugin_title(PLUGIN_KIND, name), found, "__doc__")
    summary = (said if isinstance(said, str) and said else "a rule of an installed package").partition("\n")[0]
    return replace(FIRST_ORDER, summary=summary, make_rule=lambda: _ForeignRule(name, found))


def find_rule(name: str) -> GuidanceRule:
    """Return the rule of one run of the method of that name; raises as `find_method` does, also where it cannot be made."""
    return call_foreign(f"guidance rule '{name}' failed", find_method(name).make_rule)


class _ForeignRule:
    """The rule that a package's class makes; what it raises is named."""

    def __init__(self, name: str, make_rule: Callable[[], GuidanceRule]) -> None:
        self._what = f"guidance rule '{name}' failed"
        self._rule = call_foreign(self._what, make_rule)
        if not callable(self._rule):
            raise InputError(
                f"{plugin_title(PLUGIN_KIND, name)} made a {type(self._rule).__name__}; expected a rule that is called with "
                "a `ReverseStep` and returns x_{t-1}; mend the package"
            )
        self._name = name

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        return call_foreign(self._what, self._rule, step)

    def __repr__(self) -> str:
        return repr(self._name)
