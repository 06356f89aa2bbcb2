"""How well pairs of surfaces hold a scan in its six freedoms.

The smallest residual does not tell: along a bare corridor every slide fits, in a round stairwell every turn. What is
held can be read from the normals of the paired surface alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

Axis = tuple[float, float, float]


@dataclass(frozen=True)
class Hold:
    """The least held shift and the least held turn.

    Args:
        shift: smallest eigenvalue of the mean of ``n n^T`` over the normals: 1/3 at best, 0 where the scan slides.
        shift_axis: its direction.
        turn: how well the least held turn is held when the scan may shift along with it: what part of the pairs' way
            is along their normals, in the mean of the squares; 0 where the scan turns freely.
        turn_axis: the axis of that turn, through the middle of the pairs.
    """

    shift: float
    shift_axis: Axis
    turn: float
    turn_axis: Axis


def hold(positions: NDArray[np.float64], normals: NDArray[np.float64]) -> Hold:
    """What point-to-plane pairs hold: every motion that they let pass shows as a small shift or turn.

    A motion is a turn (w) with a shift (v). Without a turn it is small in the normals' own mean; with one, in what is
    left of the turn's information after the best shift is taken out (the Schur complement), which finds the turn about
    the axis of a cylinder wherever the scanner stood.

    Args:
        positions: ``(N, 3)`` of the pairs, metres.
        normals: ``(N, 3)`` of the reference there, unit length.
    """
    if len(positions) < 6:
        return Hold(0.0, (0.0, 0.0, 1.0), 0.0, (0.0, 0.0, 1.0))
    arms = positions - positions.mean(axis=0)
    levers = np.cross(arms, normals)
    shifts = normals.T @ normals / len(normals)
    turns, both = levers.T @ levers / len(normals), levers.T @ normals / len(normals)
    freed = turns - both @ np.linalg.pinv(shifts, rcond=1e-6, hermitian=True) @ both.T
    # How far a turn moves the pairs: mean of |axis x arm|^2.
    ways = np.eye(3) * np.mean(np.einsum("ij,ij->i", arms, arms)) - arms.T @ arms / len(arms) + 1e-6 * np.eye(3)
    return Hold(*_weakest(shifts, np.eye(3)), *_weakest(freed, ways))


def _weakest(information: NDArray[np.float64], scale: NDArray[np.float64]) -> tuple[float, Axis]:
    values, axes = eigh(information, scale)
    x, y, z = axes[:, 0] / np.linalg.norm(axes[:, 0])
    return max(float(values[0]), 0.0), (float(x), float(y), float(z))
