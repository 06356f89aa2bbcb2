"""Whether a registration may enter the map: what is not certain is refused, with its reason."""

from dataclasses import dataclass

import numpy as np

from perception.failure import FailureError
from perception.findings import Registration


@dataclass(frozen=True)
class RegistrationLimits:
    """What :func:`judge` demands.

    Args:
        min_overlap: share of the source on known surface.
        min_agreement: of the overlapping share, the part that fits within the last correspondence distance.
        max_rmse: metres.
        max_conflict: share of the comparable surface that was seen through.
        min_eigenvalue: of the pairs' normals; below it the scan slides.
        min_turn: share of a turn's way that is along the normals; below it the scan turns freely.
        sigmas: how many times the expected error of the guess the correction may be.
        slack_m, slack_rad: correction that is allowed whatever was expected.
    """

    min_overlap: float = 0.15
    min_agreement: float = 0.70
    max_rmse: float = 0.015
    max_conflict: float = 0.03
    min_eigenvalue: float = 0.02
    min_turn: float = 0.005
    sigmas: float = 3.0
    slack_m: float = 0.10
    slack_rad: float = float(np.deg2rad(1.5))

    def allowed(self, expected_error: tuple[float, float]) -> tuple[float, float]:
        """Largest correction in metres and radians of a guess with this standard deviation."""
        return (
            self.sigmas * expected_error[0] + self.slack_m,
            self.sigmas * expected_error[1] + self.slack_rad,
        )


NEAR_ODOMETRY = RegistrationLimits(max_conflict=0.09)
"""Where the guess is odometry's and the correction must agree with it, a mirror's ghosts need not refuse a scan.

From behind a pane that mirrors a whole wall, 7 % of the known surface is seen through. A tenth would leave nothing of
a pose's plausibility, so that every other one would be its rival.
"""


def is_held(registration: Registration, limits: RegistrationLimits = RegistrationLimits()) -> bool:
    """Whether the paired surface holds the scan in all six freedoms."""
    return registration.min_eigenvalue >= limits.min_eigenvalue and registration.turn_hold >= limits.min_turn


def is_faultless(registration: Registration) -> bool:
    """Whether :func:`judge` finds nothing against a registration but what odometry may have to say."""
    try:
        judge(registration, (np.inf, np.inf))
    except FailureError:
        return False
    return True


def judge(
    registration: Registration,
    expected_error: tuple[float, float],
    limits: RegistrationLimits = RegistrationLimits(),
) -> None:
    """Return if the registration may enter the map.

    Args:
        expected_error: standard deviation of the guess in metres and radians.

    Raises:
        FailureError: ``REG_DIVERGED``, ``REG_LOW_OVERLAP``, ``REG_DEGENERATE`` or ``REG_INCONSISTENT``.
    """
    evidence: dict[str, object] = {
        "fitness": registration.fitness,
        "rmse": registration.rmse,
        "overlap": registration.overlap,
        "min_eigenvalue": registration.min_eigenvalue,
        "weak_axis": list(registration.weak_axis),
        "turn_hold": registration.turn_hold,
        "turn_axis": list(registration.turn_axis),
        "correction_m": registration.correction_m,
        "correction_rad": registration.correction_rad,
        "conflict": registration.conflict,
        "method": registration.method,
    }

    def refuse(code: str, message: str) -> FailureError:
        return FailureError(code, message, **evidence)

    if not np.isfinite(registration.map_from_scanner).all():
        raise refuse("REG_DIVERGED", "the registration is not finite")
    if registration.overlap < limits.min_overlap:
        raise refuse(
            "REG_LOW_OVERLAP",
            f"only {registration.overlap:.0%} of the scan lies on known surface "
            f"(at least {limits.min_overlap:.0%} needed)",
        )
    agreement = registration.fitness / registration.overlap
    if agreement < limits.min_agreement or registration.rmse > limits.max_rmse:
        raise refuse(
            "REG_DIVERGED",
            f"{agreement:.0%} of the overlap fits, to {registration.rmse * 1000:.1f} mm rms "
            f"(needed {limits.min_agreement:.0%} within {limits.max_rmse * 1000:.0f} mm)",
        )
    if registration.conflict > limits.max_conflict:
        raise refuse(
            "REG_DIVERGED",
            f"{registration.conflict:.0%} of the surface that could be compared would have been seen "
            f"through (at most {limits.max_conflict:.0%})",
        )
    if registration.min_eigenvalue < limits.min_eigenvalue:
        heading = np.rad2deg(np.arctan2(registration.weak_axis[1], registration.weak_axis[0]))
        raise refuse(
            "REG_DEGENERATE",
            f"nothing holds the scan along {heading:.0f} degrees "
            f"(eigenvalue {registration.min_eigenvalue:.4f}, at least {limits.min_eigenvalue:.4f} needed)",
        )
    if registration.turn_hold < limits.min_turn:
        upright = abs(registration.turn_axis[2]) > 0.7
        raise refuse(
            "REG_DEGENERATE",
            f"nothing holds the scan from turning about {'an upright' if upright else 'a level'} axis "
            f"(hold {registration.turn_hold:.4f}, at least {limits.min_turn:.4f} needed)",
        )
    allowed_m, allowed_rad = limits.allowed(expected_error)
    if registration.correction_m > allowed_m or registration.correction_rad > allowed_rad:
        raise refuse(
            "REG_INCONSISTENT",
            f"the scan lies {registration.correction_m:.2f} m and "
            f"{np.rad2deg(registration.correction_rad):.1f} degrees from where odometry has it "
            f"(at most {allowed_m:.2f} m and {np.rad2deg(allowed_rad):.1f} degrees)",
        )
