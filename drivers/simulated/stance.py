"""What the simulated scanner must know of the base that it stands on."""

from dataclasses import dataclass

from drivers.simulated.bodies import Body
from perception.transforms import Matrix


@dataclass(frozen=True)
class Stance:
    """The truth about where the robot stands: 4x4 on the floor of the world, its lean, and who is around.

    Args:
        map_from_base: 4x4 pose in the frame of the world (the evaluation aligns the mission's map with it).
        tilt: roll and pitch, radians.
        bodies: people and carts.
        moving: whether the wheels turn.
    """

    map_from_base: Matrix
    tilt: tuple[float, float]
    bodies: tuple[Body, ...]
    moving: bool
