"""Whether the odometry that a mission knew still tells where its robot stands, after a time in which nobody led it."""

from dataclasses import replace

from drivers.interfaces import BaseState
from perception import transforms

_STILL_M, _STILL_RAD = 0.01, 0.005
_MOVED = "+"


class Footing:
    """Names the odometry's frame over the lives of a mission's executive.

    A base agent that began anew gives its odometry a new frame by itself. One that did not may have been pushed while
    the executive was dead: where its odometry stands elsewhere than the mission left it, and no drive of the mission's
    own explains that, what was known of its place counts no more, and the frame gets a new name as well. A robot that
    is lifted and carried without a wheel turning is not noticed.

    Args:
        known: the base as the interrupted mission knew it last; None for a mission that begins.
        led: whether it was on a drive of that mission then.
    """

    def __init__(self, known: BaseState | None, led: bool) -> None:
        self._known = known
        self._led = led
        self._names: dict[str, str] = {}

    def named(self, live: BaseState) -> BaseState:
        """What the base says, in the frame that the mission knows it by."""
        if self._known is None:
            return live
        if not self._names:
            self._names[live.odom_frame] = self._name(self._known, live)
        return replace(live, odom_frame=self._names.get(live.odom_frame, live.odom_frame))

    def _name(self, known: BaseState, live: BaseState) -> str:
        if known.odom_frame.rstrip(_MOVED) != live.odom_frame:
            return live.odom_frame
        metres, radians = transforms.difference(known.odom_from_base, live.odom_from_base)
        stood = metres < _STILL_M and radians < _STILL_RAD
        return known.odom_frame if stood or self._led else known.odom_frame + _MOVED
