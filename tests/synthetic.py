"""Small ray-cast rooms for the perception tests: exact truth, no drivers."""

from collections.abc import Iterable

import numpy as np
import open3d as o3d

from perception import transforms
from perception.scan import BeamPattern, Scan

COARSE = BeamPattern.with_step(np.deg2rad(1.0), (np.deg2rad(-40), np.deg2rad(60)), (0.5, 120.0))
FINE = BeamPattern.with_step(np.deg2rad(0.4), (np.deg2rad(-40), np.deg2rad(60)), (0.5, 120.0))


def box(lower: Iterable[float], upper: Iterable[float]) -> o3d.t.geometry.TriangleMesh:
    """A closed axis-aligned box between two corners, metres."""
    lower, upper = np.asarray(list(lower), float), np.asarray(list(upper), float)
    mesh = o3d.geometry.TriangleMesh.create_box(*(upper - lower)).translate(lower)
    return o3d.t.geometry.TriangleMesh.from_legacy(mesh)


class Scene:
    """Boxes and triangles to take scans in; a room is a box seen from inside."""

    def __init__(self, *meshes: o3d.t.geometry.TriangleMesh) -> None:
        self._scene = o3d.t.geometry.RaycastingScene()
        for mesh in meshes:
            self._scene.add_triangles(mesh)

    def take(
        self,
        map_from_scanner: np.ndarray,
        pattern: BeamPattern = COARSE,
        noise: float = 0.003,
        seed: int = 0,
        scan_id: str = "S01",
    ) -> Scan:
        """Scan from a pose (4x4); range noise in metres, seeded."""
        directions = pattern.directions()
        origin = map_from_scanner[:3, 3].astype(np.float32)
        world = directions @ map_from_scanner[:3, :3].T.astype(np.float32)
        rays = np.concatenate([np.broadcast_to(origin, world.shape), world], axis=1)
        distance = self._scene.cast_rays(o3d.core.Tensor(np.ascontiguousarray(rays, np.float32)))["t_hit"].numpy()
        beam = np.flatnonzero((distance >= pattern.range_min) & (distance <= pattern.range_max)).astype(np.int32)
        measured = distance[beam] + np.random.default_rng(seed).normal(0, noise, len(beam)).astype(np.float32)
        points = (directions[beam] * measured[:, None]).astype(np.float32)
        return Scan(
            scan_id, points, np.ones(len(beam), np.float32), beam, pattern, np.eye(4), transforms.planar(0, 0, 0)
        )
