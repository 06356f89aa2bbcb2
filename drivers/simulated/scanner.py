"""The simulated terrestrial scanner: every beam is followed through glass and off mirrors to where it ends."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.bodies import Body
from drivers.simulated.profile import ScannerProfile
from drivers.simulated.surroundings import Hits, Rays, Surroundings
from drivers.simulated.world import Surface, World
from drivers.wire.naming import own_name
from perception import transforms
from perception.scan import BeamPattern, Scan
from perception.transforms import Matrix

_MAX_BOUNCES = 5
_PAST_THE_PANE = 1e-3
_REFLECTIVITY = {Surface.CEILING: 0.9, Surface.WALL: 0.8, Surface.DOOR_LEAF: 0.6, Surface.FLOOR: 0.4}
_OTHER_REFLECTIVITY = 0.5
_PANE_TRANSMISSION = 0.8


@dataclass(frozen=True)
class Echo:
    """How each beam ended: total length (inf for none), cosine of the incidence there, share of light that is left."""

    length: NDArray[np.float32]
    cos_incidence: NDArray[np.float32]
    brightness: NDArray[np.float32]


class SimulatedScanner:
    """Takes scans of a world: range noise, lost returns, glass, mirrors, tilt.

    Args:
        world: mesh with one class per triangle.
        profile: figures of the instrument.
        seed: of this instrument; the systematic errors are drawn from it once, the noise anew for each scan name.
    """

    def __init__(self, world: World, profile: ScannerProfile, seed: int = 0) -> None:
        self.profile = profile
        self._surroundings = Surroundings(world)
        self.seed = seed
        instrument = np.random.default_rng(seed)
        self._offset = float(np.clip(instrument.normal(), -1.5, 1.5)) * profile.offset_sigma
        self._phase = float(instrument.uniform(0, 2 * np.pi))

    def map_from_scanner(self, map_from_base: Matrix, tilt: tuple[float, float] = (0.0, 0.0)) -> Matrix:
        """True pose of the optical centre of a base that leans by (roll, pitch) radians."""
        return map_from_base @ transforms.from_euler(*tilt, 0.0) @ self.profile.base_from_scanner

    def cast(
        self,
        map_from_base: Matrix,
        step: float,
        scan_id: str,
        odom_from_base: Matrix,
        tilt: tuple[float, float] = (0.0, 0.0),
        bodies: Sequence[Body] = (),
    ) -> Scan:
        """One scan from where the base truly stands.

        Args:
            map_from_base: 4x4, true pose of the base on the floor of the world.
            step: angle between neighbouring beams, radians.
            scan_id: name of the scan; with the seed, what its own mission calls it settles the noise.
            odom_from_base: 4x4, what the base believes; only passed on.
            tilt: roll and pitch of the base where it stands, radians.
            bodies: people and carts that are there.
        """
        rng = np.random.default_rng((self.seed, zlib.crc32(own_name(scan_id).encode())))
        pattern = self.profile.pattern(step)
        pose = self.map_from_scanner(map_from_base, tilt)
        directions = pattern.directions()
        echo = self._follow(_rays(pose, directions), (*bodies, self._own_body(map_from_base)), rng)
        measured = self._measure(echo, pattern, rng)
        beam = np.flatnonzero(np.isfinite(measured)).astype(np.int32)
        intensity = np.clip(echo.brightness[beam] * echo.cos_incidence[beam], 0.0, 1.0)
        return Scan(
            scan_id=scan_id,
            points=directions[beam] * measured[beam, None],
            intensity=intensity.astype(np.float32),
            beam=beam,
            pattern=pattern,
            odom_from_base=odom_from_base,
            base_from_scanner=self.profile.base_from_scanner,
        )

    def _own_body(self, map_from_base: Matrix) -> Body:
        length, width, height = self.profile.body
        return Body(*transforms.to_planar(map_from_base), length, width, height, round=False)

    def _follow(self, rays: Rays, bodies: Sequence[Body], rng: np.random.Generator) -> Echo:
        """Follow each beam to the surface that throws it back, summing up its way."""
        length = np.full(len(rays), np.inf, np.float32)
        cosine = np.ones(len(rays), np.float32)
        brightness = np.ones(len(rays), np.float32)
        way = np.zeros(len(rays), np.float32)
        alive = np.arange(len(rays))
        for _ in range(_MAX_BOUNCES):
            hits = self._surroundings.meet(rays, bodies)
            found = np.isfinite(hits.distance)
            cos = np.abs(np.einsum("ij,ij->i", hits.normal, rays[:, 3:]))
            glass = found & (hits.surface == Surface.GLASS)
            passes = glass & (rng.random(len(rays)) >= self._pane_echo(cos))
            mirrored = found & (hits.surface == Surface.MIRROR)
            ends = found & ~passes & ~mirrored
            length[alive[ends]] = way[ends] + hits.distance[ends]
            cosine[alive[ends]] = cos[ends]
            brightness[alive[ends]] *= _reflectivity(hits.surface[ends])
            brightness[alive[passes]] *= _PANE_TRANSMISSION
            onward = passes | mirrored
            if not onward.any():
                break
            rays, way = _go_on(rays, way, hits, onward, mirrored)
            alive = alive[onward]
        return Echo(length, cosine, brightness)

    def _pane_echo(self, cos: NDArray[np.float32]) -> NDArray[np.float64]:
        """Chance that a pane itself answers: dirt at any angle, its gloss only when hit head-on."""
        head_on = cos > np.cos(np.deg2rad(self.profile.glass_specular_deg))
        return np.where(head_on, self.profile.glass_specular_echo, self.profile.glass_echo)

    def _measure(self, echo: Echo, pattern: BeamPattern, rng: np.random.Generator) -> NDArray[np.float32]:
        """Measured ranges; inf where nothing comes back, at grazing incidence and outside the range limits."""
        profile = self.profile
        start, end = profile.grazing_deg
        incidence = np.rad2deg(np.arccos(np.clip(echo.cos_incidence, 0.0, 1.0)))
        lost = rng.random(pattern.size, np.float32) < (incidence - start) / (end - start)
        length = np.where(np.isfinite(echo.length), echo.length, np.float32(2 * pattern.range_max))
        cyclic = profile.cyclic_amplitude * np.sin(2 * np.pi * length / profile.cyclic_wavelength + self._phase)
        noise = rng.standard_normal(pattern.size, np.float32) * np.float32(profile.noise_sigma)
        measured = length + noise + (cyclic + self._offset).astype(np.float32)
        outside = ~((measured >= pattern.range_min) & (measured <= pattern.range_max))
        return np.where(lost | outside, np.float32(np.inf), measured)


def _rays(pose: Matrix, directions: NDArray[np.float32]) -> Rays:
    rays = np.empty((len(directions), 6), np.float32)
    rays[:, :3] = pose[:3, 3]
    rays[:, 3:] = directions @ pose[:3, :3].T.astype(np.float32)
    return rays


def _go_on(
    rays: Rays, way: NDArray[np.float32], hits: Hits, onward: NDArray[np.bool_], mirrored: NDArray[np.bool_]
) -> tuple[Rays, NDArray[np.float32]]:
    """The rays that go on from where they met a pane (straight) or a mirror (reflected), and their way so far."""
    origin, direction = rays[onward, :3], rays[onward, 3:]
    normal, distance = hits.normal[onward], hits.distance[onward]
    off_mirror = mirrored[onward, None]
    along_normal = np.einsum("ij,ij->i", direction, normal)[:, None]
    turned = np.where(off_mirror, direction - 2 * along_normal * normal, direction)
    start = origin + direction * distance[:, None] + turned * np.float32(_PAST_THE_PANE)
    way = way[onward] + distance + np.float32(_PAST_THE_PANE)
    return np.concatenate([start, turned], axis=1, dtype=np.float32), way


def _reflectivity(surface: NDArray[np.int16]) -> NDArray[np.float32]:
    # One place more than there are classes: index -1 is a body.
    table = np.full(max(Surface) + 2, _OTHER_REFLECTIVITY, np.float32)
    for kind, share in _REFLECTIVITY.items():
        table[kind] = share
    return table[surface]
