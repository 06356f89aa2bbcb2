"""One cycle ``t``: a scan, its place, the maps, the next best view and the way there (paper, Fig. 1)."""

from py_trees.behaviour import Behaviour

from behaviours.conditions import (
    FailureIs,
    MapFrameIsMade,
    NoScanYet,
    RoomIsEnded,
    RoomIsNew,
    ScanHasGuess,
    ScanIsSetAside,
)
from behaviours.mapping import (
    AnchorScan,
    BuildMap,
    LabelSpace,
    PlaceScanSetAside,
    RegisterGlobally,
    RegisterScan,
    SegmentRoom,
    SetScanAside,
)
from behaviours.movement import LetThemPass, LookForMovement
from behaviours.recover import Recover
from behaviours.settings import Settings
from behaviours.viewing import AssessRoom, ChooseView
from trees import recovery
from trees.compose import first_that_works, if_possible, steps
from trees.errands import bridge, drive, enough_charge, move_nearby
from trees.scanning import scan_here


def cycle(settings: Settings) -> Behaviour:
    return steps("cycle", observation(settings), enough_charge(settings), next_view(settings))


def observation(settings: Settings) -> Behaviour:
    """A scan, and all maps with it in them."""
    return steps(
        "observe",
        undisturbed_scan(settings),
        if_possible(
            "scan set aside",
            steps("try it again", ScanIsSetAside("one waits?"), PlaceScanSetAside("register the scan set aside")),
        ),
        recovery.written(SegmentRoom("find the room's contour")),
        recovery.written(BuildMap("build the robot map")),
        recovery.written(LabelSpace("label the voxel space")),
    )


def undisturbed_scan(settings: Settings) -> Behaviour:
    """A scan with an accepted pose, and where much moved in it another one, from the same place when they have gone."""
    return steps(
        "scan of the room alone",
        registered_scan(settings),
        first_that_works(
            "alone?",
            RoomIsNew("nothing to compare with?"),
            LookForMovement("look for who moved"),
            if_possible(
                "scan once more",
                steps(
                    "when they have gone",
                    FailureIs("anybody in it?", "DYN_POINTS"),
                    LetThemPass("let them pass"),
                    scan_here(settings),
                    first_that_works("place it", place(), SetScanAside("set it aside")),
                    LookForMovement("look again"),
                ),
            ),
        ),
    )


def registered_scan(settings: Settings) -> Behaviour:
    """A scan with an accepted pose."""
    return Recover(
        "registered scan",
        primary=steps("scan and place", scan(settings), place()),
        recovery=bridge(settings),
        attempts=2,
    )


def scan(settings: Settings) -> Behaviour:
    """A usable scan: tried again on the spot, then from a spot nearby."""
    return Recover(
        "scan",
        primary=scan_here(settings),
        recovery=move_nearby(settings),
        attempts=settings.scanning.spots,
    )


def place() -> Behaviour:
    """The first scan makes the map frame, the others are registered in it."""
    return first_that_works(
        "place the scan",
        steps("first scan", NoScanYet("no scan yet?"), AnchorScan("make the map frame")),
        steps(
            "later scan",
            MapFrameIsMade("map frame made?"),
            first_that_works(
                "register",
                steps("near the guess", ScanHasGuess("odometry unbroken?"), RegisterScan("register from odometry")),
                RegisterGlobally("register by features"),
            ),
        ),
    )


def next_view(settings: Settings) -> Behaviour:
    """The room is complete, or the robot stands at the next best view that can be reached."""
    return Recover(
        "next view",
        primary=steps(
            "view",
            recovery.written(ChooseView("choose the next best view")),
            AssessRoom("judge λ and μ"),
            first_that_works("go on", RoomIsEnded("room ended?"), drive("drive to the view", settings)),
        ),
        recovery=recovery.next_best_instead(),
        attempts=settings.driving.view_attempts,
    )
