"""How planning or playing a motion can end."""

from enum import Enum


class Outcome(str, Enum):
    """The end of an execution or of one attempt; its value, the name in lower case, is written into files.

    episode.json has the name; `sentence` is for people.
    """

    sentence: str

    def __new__(cls, value: str, sentence: str = "") -> "Outcome":  # noqa: PYI034 - an enum has no subclasses
        """Make a member of the value that stands in files and the sentence."""
        outcome = str.__new__(cls, value)
        outcome._value_, outcome.sentence = value, sentence
        return outcome

    SUCCESS = "success", "success"
    DIVERGED = "diverged", "the simulation diverged"
    WORKER_DIED = "worker_died", "the process that simulated it died"
    DROPPED = "dropped", "the object left what carried it"
    TURNED = "turned", "the object turned away from its motion by 15 degrees or more"
    DRIFTED = "drifted", "the object's centre went more than 20 mm off the path of its turn"
    TURNED_SHORT = "turned_short", "the object turned by less than 80% of the angle asked for"
    FELL_SHORT = "fell_short", "the object moved less than 80% of the length asked for"
    HAND_IN_ENVIRONMENT = "hand_in_environment", "the hand got more than 2 mm into the surroundings"
    PRESSED_TOO_HARD = "pressed_too_hard", "a link pressed harder on the object than it may"
    UNSUPPORTED = "unsupported", "nothing below carries the object at rest"
    WOULD_TIP = "would_tip", "the object would tip before enough of it is free to be grasped"
    WOULD_OVERHANG = "would_overhang", "the object would hang over too far before it can be grasped"
    NO_EDGE = "no_edge", "there is no edge within reach over which the object could be grasped"
    OBSTRUCTED = "obstructed", "something is in the object's way"
    NO_CONFIGURATION = "no_configuration", "no configuration is left to push with"
    NO_LONGER_FITS = "no_longer_fits", "no configuration fits where the object lies now"
    APPROACH_BLOCKED = "approach_blocked", "the hand has no free way to contact"
    TIPPED = "tipped", "the object tipped by more than 15 degrees"
    STOPPED_SHORT = "stopped_short", "the object stopped before enough of it was free to be grasped"
    NO_GRASP = "no_grasp", "no grasp was found"
    SLIPPED = "slipped", "the object slipped on the lift"
    SANK = "sank", "the object sank while it was held"
    STILL_CARRIED = "still_carried", "the surroundings still carried the object while it was held"
    FELL = "fell", "the object fell"
    NOTHING_PLAYED = "nothing_played", "there was nothing to play"
