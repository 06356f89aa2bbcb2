"""What goes wrong, and when: scripted people and faults of one simulated mission."""

from pathlib import Path
from typing import Annotated

import msgspec
import yaml

from drivers.simulated.bodies import Track


class ScannerFaults(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Faults of the scanner.

    Args:
        fail_first: so many scans end with ``SCAN_FAILED``.
        hang_first: so many scans after those never end.
        truncate_first: so many scans after those keep only a tenth of their points.
        self_test: what the instrument's monitor complains of, in words.
    """

    fail_first: int = 0
    hang_first: int = 0
    truncate_first: int = 0
    self_test: tuple[str, ...] = ()


class BaseFaults(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Faults of the base.

    Args:
        slip_at: true distances (m) at which the wheels spin, each half a metre that is not driven.
        emergency_stop: (from, to) in simulated seconds while the red button is pressed.
        battery: charge at the start, as a share.
    """

    slip_at: tuple[float, ...] = ()
    emergency_stop: tuple[tuple[float, float], ...] = ()
    battery: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 1.0


class Scenario(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything scripted about a mission; nothing by default."""

    tracks: tuple[Track, ...] = ()
    scanner: ScannerFaults = ScannerFaults()
    base: BaseFaults = BaseFaults()


def load_scenario(path: Path) -> Scenario:
    """Read a scenario from YAML, keys as in :class:`Scenario`.

    Raises:
        msgspec.ValidationError: for a key it does not know, or a value of another type.
    """
    return msgspec.convert(yaml.safe_load(path.read_text()) or {}, Scenario)
