"""How planning or playing a motion can end."""

from enum import Enum


class Outcome(str, Enum):
    """The end of an execution or of one attempt; its value is written into files, its `sentence` is for people."""

    SUCCESS = "success"
    DIVERGED = "diverged"
    WORKER_DIED = "worker_died"
    DROPPED = "dropped"
    TURNED = "turned"
    FELL_SHORT = "fell_short"
    HAND_IN_ENVIRONMENT = "hand_in_environment"
    UNSUPPORTED = "unsupported"
    WOULD_TIP = "would_tip"
    WOULD_OVERHANG = "would_overhang"
    NO_EDGE = "no_edge"
    OBSTRUCTED = "obstructed"
    NO_CONFIGURATION = "no_configuration"
    NO_LONGER_FITS = "no_longer_fits"
    APPROACH_BLOCKED = "approach_blocked"
    TIPPED = "tipped"
    STOPPED_SHORT = "stopped_short"
    NO_GRASP = "no_grasp"
    SLIPPED = "slipped"
    SANK = "sank"
    STILL_CARRIED = "still_carried"
    FELL = "fell"
    NOTHING_PLAYED = "nothing_played"

    @property
    def sentence(self) -> str:
        """The outcome in words."""
        return SENTENCES[self]


SENTENCES = {
    Outcome.SUCCESS: "success",
    Outcome.DIVERGED: "the simulation diverged",
    Outcome.WORKER_DIED: "the process that simulated it died",
    Outcome.DROPPED: "the object left what carried it",
    Outcome.TURNED: "the object turned by 15 degrees or more",
    Outcome.FELL_SHORT: "the object moved less than 80% of the length asked for",
    Outcome.HAND_IN_ENVIRONMENT: "the hand got more than 2 mm into the surroundings",
    Outcome.UNSUPPORTED: "nothing below carries the object at rest",
    Outcome.WOULD_TIP: "the object would tip before enough of it is free to be grasped",
    Outcome.WOULD_OVERHANG: "the object would hang over too far before it can be grasped",
    Outcome.NO_EDGE: "there is no edge within reach over which the object could be grasped",
    Outcome.OBSTRUCTED: "something is in the object's way",
    Outcome.NO_CONFIGURATION: "no configuration is left to push with",
    Outcome.NO_LONGER_FITS: "no configuration fits where the object lies now",
    Outcome.APPROACH_BLOCKED: "the hand has no free way to contact",
    Outcome.TIPPED: "the object tipped by more than 15 degrees",
    Outcome.STOPPED_SHORT: "the object stopped before enough of it was free to be grasped",
    Outcome.NO_GRASP: "no grasp was found",
    Outcome.SLIPPED: "the object slipped on the lift",
    Outcome.SANK: "the object sank while it was held",
    Outcome.STILL_CARRIED: "the surroundings still carried the object while it was held",
    Outcome.FELL: "the object fell",
    Outcome.NOTHING_PLAYED: "there was nothing to play",
}
