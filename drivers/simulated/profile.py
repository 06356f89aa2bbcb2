"""Figures of the simulated instruments; every one may be set by a configuration."""

from dataclasses import dataclass

import numpy as np

from perception import transforms
from perception.scan import BeamPattern
from perception.transforms import Matrix


@dataclass(frozen=True)
class ScannerProfile:
    """A terrestrial laser scanner on its mast.

    The systematic share of the range error belongs to the instrument, not to the scan: a constant offset
    (sigma ``offset_sigma``) and a slow cyclic error over the range (amplitude ``cyclic_amplitude``, wavelength
    ``cyclic_wavelength``), together 5 mm. Both widen a room evenly round the scanner, so that poses stay within a few
    millimetres although single walls are off by 5 mm, as with the real instrument.

    Args:
        elevation_deg: lowest and highest beam.
        range_min, range_max: metres; nothing returns outside.
        noise_sigma: of a single range, metres.
        grazing_deg: incidence at which returns begin to be lost, and from which none is left.
        glass_echo: share of beams that get a weak return from a pane; near head-on (within ``glass_specular_deg``)
            it is ``glass_specular_echo``. All others pass through to what is behind.
        duration: of a scan, simulated seconds, whatever its step.
        mount: optical centre in base_link, metres.
        body: length, width and height of what the scanner stands on; shadows the beams that meet it.
    """

    model: str = "vz-400"
    elevation_deg: tuple[float, float] = (-40.0, 60.0)
    range_min: float = 1.5
    range_max: float = 120.0
    noise_sigma: float = 0.003
    offset_sigma: float = 0.0045
    cyclic_amplitude: float = 0.003
    cyclic_wavelength: float = 20.0
    grazing_deg: tuple[float, float] = (80.0, 88.0)
    glass_echo: float = 0.03
    glass_specular_echo: float = 0.5
    glass_specular_deg: float = 2.0
    duration: float = 45.0
    mount: tuple[float, float, float] = (0.0, 0.0, 1.3)
    body: tuple[float, float, float] = (0.9, 0.6, 0.9)

    @property
    def base_from_scanner(self) -> Matrix:
        return transforms.from_euler(0.0, 0.0, 0.0, self.mount)

    def pattern(self, step: float) -> BeamPattern:
        """The beams fired at an angular step in radians."""
        low, high = np.deg2rad(self.elevation_deg)
        return BeamPattern.with_step(step, (float(low), float(high)), (self.range_min, self.range_max))


SCANNERS = {
    "vz-400": ScannerProfile(),
    "vz-400i": ScannerProfile(model="vz-400i", range_min=0.5),
}


@dataclass(frozen=True)
class LidarProfile:
    """The planar safety scanner: two corner units merged into one full turn round ``base_link``.

    Args:
        beams: over 360 degrees, the first straight ahead, counter-clockwise.
        height: of the plane above the floor, metres.
        interval: between two turns, simulated seconds.
    """

    beams: int = 720
    height: float = 0.2
    range_max: float = 15.0
    noise_sigma: float = 0.007
    interval: float = 0.1


@dataclass(frozen=True)
class GuardProfile:
    """The depth sensors round the mast that look for table tops and the like close to the robot.

    Args:
        columns: azimuths over 360 degrees.
        height: of the sensors above the floor, metres.
        slopes: of the rays, rise per metre.
        band: heights above the floor that matter, metres.
    """

    columns: int = 120
    height: float = 1.25
    slopes: tuple[float, ...] = (-1.6, -1.2, -0.95, -0.78, -0.66, -0.56, -0.48, -0.42, -0.36, -0.2, 0.0, 0.15, 0.35)
    band: tuple[float, float] = (0.12, 1.5)
    range_max: float = 2.5
    noise_sigma: float = 0.005


@dataclass(frozen=True)
class OdometryProfile:
    """How the encoders lie. Scale errors are drawn once per run, uniformly within their bounds.

    Args:
        distance_scale, rotation_scale: bounds, as a share.
        heading_walk: standard deviation of the heading after one metre, radians; grows with the square root.
        slips_per_metre: expected slip events; each adds up to ``slip_distance`` metres that were not driven and
            misses up to ``slip_heading`` radians of turn.
    """

    distance_scale: float = 0.02
    rotation_scale: float = 0.02
    heading_walk: float = float(np.deg2rad(0.5))
    slips_per_metre: float = 0.05
    slip_distance: float = 0.03
    slip_heading: float = float(np.deg2rad(1.0))


@dataclass(frozen=True)
class BaseProfile:
    """The differential drive and its limits (SI units); footprint is length x width, centred on ``base_link``."""

    model: str = "guardian-sim"
    footprint: tuple[float, float] = (0.9, 0.6)
    track_width: float = 0.5
    speed: float = 0.5
    turn_rate: float = 0.6
    acceleration: float = 0.5
    turn_acceleration: float = 1.2
    time_step: float = 0.05
    tilt_max: float = float(np.deg2rad(1.5))
    lidar: LidarProfile = LidarProfile()
    guard: GuardProfile = GuardProfile()
    odometry: OdometryProfile = OdometryProfile()
