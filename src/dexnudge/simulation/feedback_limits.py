"""The bounds of what feedback answers."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FeedbackLimits:
    """How far, and how fast, feedback may go away from the plan.

    Attributes:
        room: share of a link's greatest force that is asked of it; the rest is left to control. most: share above
            which the whole hand presses less.
        press: least and greatest press, times the planned one. press_rate, relax_rate: of its rise and fall [1/s].
        slip: way by which the object may stay behind the palm [m]; so far fingers give way.
        pull: times the planned ratio of pull to press above which the hand presses harder.
        tilt: of the object against the plan above which the hand presses less, or more where it pinches it [rad].
        slowest: share of the speed at which the hand waits for the object, longest_wait: in all [s].
        close: lag at the end that is left [m]. most_ahead: way that the hand pushes on, [m] and share of the length.
        lost: slip of an object that stands still, above which the push ends [m]. most_off: turn of the object away from the
            plan above which it ends, too [rad].
        grip: share of what a pinch should press with, link by link, below which it is given up while it tips the object.
        aim_way: way over which an error across the motion is answered [m]. aside [m], turned [rad]: most of that answer.
        track_time: in which the base catches up with its own path [s]. tracked: least and greatest lead of its target [m].
        link_time, base_time: in which fingers and base bring a link's force to what it should be [s]. band: share of the
            force by which it may be off. over: times as fast above the limit. leak: time in which this is forgotten [s].
        base_force [N], base_torque [N m]: most that is so added to the base's, along and about each axis.
    """

    room: float = 0.8
    most: float = 0.88
    press: tuple[float, float] = (0.4, 2.5)
    press_rate: float = 4.0
    relax_rate: float = 0.3
    slip: float = 0.002
    pull: float = 1.15
    tilt: float = 0.008
    slowest: float = 0.3
    longest_wait: float = 0.7
    close: float = 0.003
    most_ahead: tuple[float, float] = (0.03, 0.3)
    lost: float = 0.008
    most_off: float = 0.15
    grip: float = 0.4
    aim_way: float = 0.03
    aside: float = 0.005
    turned: float = 0.1
    track_time: float = 0.15
    tracked: tuple[float, float] = (-0.005, 0.025)
    link_time: float = 0.1
    base_time: float = 0.15
    band: float = 0.15
    over: float = 2.5
    leak: float = 0.5
    base_force: float = 10.0
    base_torque: float = 2.0
