"""`dexnudge plugins`: what is built in, what installed packages bring, and what of it is broken."""

from collections.abc import Callable
from dataclasses import dataclass

from dexnudge.cli.arguments import say


@dataclass(frozen=True)
class Plugins:
    """List hands, arms, scene families, energy terms, criteria and guidance rules, built-in ones and those of packages.

    A package names what it brings as entry points: dexnudge.hands, dexnudge.arms, dexnudge.scenes,
    dexnudge.energy_terms, dexnudge.criteria, dexnudge.guidance_rules.
    """

    def run(self) -> int:
        """Print a heading for each kind and one name a line."""
        from dexnudge.energies.terms import find_term
        from dexnudge.plugins import find_plugins
        from dexnudge.sampling.methods import find_rule
        from dexnudge.verification.criteria import find_criterion

        find: dict[str, Callable[[str], object]] = {
            "energy term": find_term,
            "criterion": find_criterion,
            "guidance rule": find_rule,
        }
        for kind, names in builtin_names().items():
            say(f"{kind}:")
            for found in find_plugins(kind, builtin=names, find=find.get(kind)):
                source = "" if found.name in names and not found.broken else f", from {found.source}"
                say(f"  {found.name}{source}" + (f"; broken: {found.broken}" if found.broken else ""))
        return 0


def builtin_names() -> dict[str, tuple[str, ...]]:
    """Return the built-in names of each kind."""
    from dexnudge.arms.registry import ARMS
    from dexnudge.energies.terms import BUILTIN_WEIGHTS
    from dexnudge.hands.named import HANDS
    from dexnudge.sampling.methods import METHODS
    from dexnudge.scenes.families import SCENE_FAMILIES
    from dexnudge.verification.criteria import default_criteria

    return {
        "hand": tuple(HANDS),
        "arm": tuple(ARMS),
        "scene": tuple(SCENE_FAMILIES),
        "energy term": BUILTIN_WEIGHTS,
        "criterion": tuple(criterion.name for criterion in default_criteria()),
        "guidance rule": tuple(METHODS),
    }
