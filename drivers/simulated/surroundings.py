"""The world's mesh and what stands in it for a moment, for rays to meet."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from drivers.simulated.bodies import Body
from drivers.simulated.world import World

Rays = NDArray[np.float32]
"""``(N, 6)``: origin and unit direction, world frame."""

BODY = -1
"""Class of a triangle of a person, a cart or the robot; the world's own classes are not negative."""


@dataclass(frozen=True)
class Hits:
    """First meeting of each ray: distance (inf for none), unit normal against the ray, class of the triangle."""

    distance: NDArray[np.float32]
    normal: NDArray[np.float32]
    surface: NDArray[np.int16]


class Surroundings:
    """Casts rays at the fixed mesh, and at bodies where there are any."""

    def __init__(self, world: World) -> None:
        self._fixed = o3d.t.geometry.RaycastingScene()
        self._fixed.add_triangles(
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(world.vertices, np.float32)),
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(world.triangles, np.uint32)),
        )
        self._surface = np.asarray(world.surface, np.int16)

    def meet(self, rays: Rays, bodies: Iterable[Body] = ()) -> Hits:
        """The nearest surface along each ray."""
        cast = self._fixed.cast_rays(o3d.core.Tensor.from_numpy(rays))
        distance = cast["t_hit"].numpy()
        normal = cast["primitive_normals"].numpy()
        # A ray that meets nothing has an invalid triangle; any class will do, for its distance is infinite.
        surface = self._surface[np.minimum(cast["primitive_ids"].numpy(), len(self._surface) - 1)]
        if scene := _scene_of(bodies):
            moving = scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
            nearer = moving["t_hit"].numpy() < distance
            distance = np.where(nearer, moving["t_hit"].numpy(), distance)
            normal = np.where(nearer[:, None], moving["primitive_normals"].numpy(), normal)
            surface = np.where(nearer, np.int16(BODY), surface)
        towards = np.einsum("ij,ij->i", normal, rays[:, 3:]) > 0
        return Hits(distance, np.where(towards[:, None], -normal, normal), surface)

    def distances(self, rays: Rays, bodies: Iterable[Body] = ()) -> NDArray[np.float32]:
        """Only the distance to the nearest surface along each ray; inf for none."""
        distance = self._fixed.cast_rays(o3d.core.Tensor.from_numpy(rays), nthreads=1)["t_hit"].numpy()
        if scene := _scene_of(bodies):
            distance = np.minimum(
                distance, scene.cast_rays(o3d.core.Tensor.from_numpy(rays), nthreads=1)["t_hit"].numpy()
            )
        return distance


def _scene_of(bodies: Iterable[Body]) -> o3d.t.geometry.RaycastingScene | None:
    scene = None
    for body in bodies:
        scene = scene or o3d.t.geometry.RaycastingScene()
        scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(_mesh(body)))
    return scene


def _mesh(body: Body) -> o3d.geometry.TriangleMesh:
    """Its surface in the world's frame."""
    if body.round:
        mesh = o3d.geometry.TriangleMesh.create_cylinder(body.width / 2, body.height, resolution=24, split=1)
        mesh.translate((0.0, 0.0, body.height / 2))
    else:
        mesh = o3d.geometry.TriangleMesh.create_box(body.length, body.width, body.height)
        mesh.translate((-body.length / 2, -body.width / 2, 0.0))
    mesh.rotate(o3d.geometry.get_rotation_matrix_from_xyz((0.0, 0.0, body.yaw)), center=(0.0, 0.0, 0.0))
    mesh.translate((body.x, body.y, 0.0))
    return mesh
