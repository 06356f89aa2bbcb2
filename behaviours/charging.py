"""Leaves that keep enough charge for the way home."""

from py_trees.common import Status

from behaviours.conditions import Condition
from behaviours.keys import Key
from behaviours.leaf import Leaf
from drivers.interfaces import BaseState
from perception.failure import FailureError


class BatteryIsGood(Condition):
    """Whether there is charge for more than the way home."""

    reads = (Key.BASE,)

    def holds(self) -> bool:
        base: BaseState | None = self.read(Key.BASE)
        return base is None or base.battery >= self.services.settings.battery.low


class WaitForCharge(Leaf):
    """Waits until the battery is full enough to go on; fails with ``BATTERY_LOW`` when nobody charges it."""

    reads = (Key.BASE,)

    def begin(self) -> None:
        self._began = self.services.clock.now()

    def step(self) -> Status:
        battery = self.services.settings.battery
        base: BaseState | None = self.read(Key.BASE)
        charge = 0.0 if base is None else base.battery
        self.say(f"charging: {charge:.0%} of {battery.charged:.0%}")
        if charge >= battery.charged:
            return Status.SUCCESS
        if self.services.clock.now() - self._began > battery.charging_s:
            raise FailureError(
                "BATTERY_LOW",
                f"the battery is at {charge:.0%} after {battery.charging_s / 60:.0f} min at the start; see its charger",
                battery=charge,
            )
        return Status.RUNNING
