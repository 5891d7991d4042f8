"""The order of draws: verified ones first, and among them those that hold in most worlds and push best."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from dexnudge.hands.hand import Hand
from dexnudge.mechanics.balance import MAX_FACTOR
from dexnudge.mechanics.contacts import ContactBatch
from dexnudge.results.path_margins import careful_margins, forward_offset, mean_help, pressing_margins
from dexnudge.results.probability import AGREEMENT as PROBABILITY_AGREEMENT
from dexnudge.results.probability import probabilities
from dexnudge.results.worlds import share_of_worlds, uncertainty_of
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import MARGIN_AGREEMENT, ROBUST_MARGIN, SUCCESS_MARGIN
from dexnudge.verification.measurements import contact_margins
from dexnudge.verification.verdicts import Verdicts


@dataclass(frozen=True)
class Ranking:
    """What draws are ranked by.

    Attributes:
        keys: most important first; less is better.
        agreement: what rounding may change in each of them.
        foresight: what files show, see `Samples.foresight`.
        tolerance: what rounding may change in each of that.
    """

    keys: Float[np.ndarray, "key draw"]
    agreement: Float[np.ndarray, " key"]
    foresight: dict[str, Float[np.ndarray, " draw"]]
    tolerance: dict[str, float]

    @property
    def order(self) -> Int[np.ndarray, " draw"]:
        """The draws, best first."""
        return np.lexsort(self.keys[::-1])

    def out_of_order(self) -> Int[np.ndarray, " place"]:
        """Return the places of those draws that are better than the one in front of them, beyond what rounding explains."""
        keys = np.nan_to_num(self.keys, nan=np.inf, posinf=np.finfo(np.float64).max)
        difference = np.diff(keys, axis=1)
        deciding = (difference != 0.0).argmax(axis=0)  # the first key in which two neighbours differ, if any
        step = np.take_along_axis(difference, deciding[None], axis=0)[0]
        return np.flatnonzero(step < -self.agreement[deciding]) + 1


def ranking(scene: Scene, verdicts: Verdicts, hand: Hand, q: Float[np.ndarray, "n coordinates"]) -> Ranking:
    """Return how draws rank: verified ones first; among them those that push best.

    That is: where something is uncertain, by the share of the worlds in which they hold (`share_of_worlds`), and then by
    what follows in the hardest of them; by the margin where the path begins, up to 1.5 (robust); by the least one on the
    path of those contacts alone that press or push, up to 1; by how near to the object's centre of mass or behind it they
    are on average; by how far they press or push; by the least penetration. Larger margins are those of hands that squeeze,
    and slip. Where the object turns, nothing but fingers that press apart from one another, or from two sides, turns it:
    what holds with less friction and blunter contacts comes first (`careful_margins`), then the margin as far as it goes.
    """
    verified = np.flatnonzero(verdicts.success)
    contacts = ContactBatch.of([verdicts.contacts[row] for row in verified])
    hardest, margin = scene, np.array(verdicts.force_margin)
    if scene.uncertainty is not None:
        hardest = replace(scene, **scene.uncertainty.hardest(scene))
        margin[verified] = contact_margins(hardest, contacts)[0].factor[:, 0]
    keys = _keys(hardest, verdicts, margin, contacts)
    foresight, tolerance = {"probability": np.full(len(q), np.nan)}, {"probability": PROBABILITY_AGREEMENT}
    foresight["probability"][verified] = probabilities(scene, contacts)
    agreement = [0.0, MARGIN_AGREEMENT, MARGIN_AGREEMENT, 1e-6, 1e-6, 1e-6]
    if (uncertainty := uncertainty_of(scene)) is not None:
        share = share_of_worlds(scene, hand, q, verdicts, np.lexsort(keys[::-1]))
        foresight["share_of_worlds"], tolerance["share_of_worlds"] = share, 1.01 / uncertainty.worlds
        keys = np.insert(keys, 1, -np.nan_to_num(share), axis=0)
        agreement.insert(1, 1.01 / uncertainty.worlds)
    return Ranking(keys, np.array(agreement), foresight, tolerance)


def _keys(
    scene: Scene, verdicts: Verdicts, margin: Float[np.ndarray, " draw"], contacts: ContactBatch
) -> Float[np.ndarray, "key draw"]:
    """Return what draws are ranked by where all is certain. margin: of forces. contacts: of those that are verified."""
    verified = np.flatnonzero(verdicts.success)
    pressing, ahead, helping = np.zeros((3, len(margin)))
    if len(verified) > 1:
        helping[verified] = mean_help(scene, contacts)
        if scene.turn is None:
            pressing[verified] = pressing_margins(scene, contacts)
            ahead[verified] = forward_offset(scene, contacts)
        else:
            pressing[verified] = careful_margins(scene, contacts)
    deepest = verdicts.deepest_penetration
    if scene.turn is None:
        margins = -np.minimum(margin, ROBUST_MARGIN), -np.minimum(pressing, SUCCESS_MARGIN)
    else:
        margins = -np.minimum(pressing, MAX_FACTOR), -np.minimum(margin, MAX_FACTOR)
    return np.stack([~verdicts.success, *margins, ahead, -helping, deepest]).astype(np.float64)
