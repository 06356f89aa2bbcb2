"""What is said on the wire between executive and agents: typed msgpack messages, one frame each.

A :class:`Query` asks and may be answered at any time. A :class:`Command` changes the world: it is obeyed once however
often it arrives, and only while fresh. Freshness needs no common clock: every reply carries the agent's ``boot`` and
``clock``, and a command names the boot it is meant for and the instant of that clock after which it is void, so that
neither a frame that a broken link held back nor one meant for the agent before its restart moves anything.
"""

from drivers.messages.base import (
    MAX_MAP_CELLS,
    AcquireLease,
    BaseIdentity,
    BaseRequest,
    Beat,
    Drive,
    DriveDone,
    DriveStatus,
    Goal,
    GoalId,
    Late,
    LeaseGranted,
    LeaseNumber,
    Nonce,
    Owner,
    ReleaseLease,
    RobotMap,
    Stop,
    Telemetry,
)
from drivers.messages.common import Identify, Ok, Pending, Pose, Problem, Stale, Unknown
from drivers.messages.envelope import (
    MAX_MESSAGE,
    MAX_SCAN,
    PROTOCOL,
    Body,
    Command,
    Count,
    Finite,
    Fraction,
    Name,
    Query,
    Reply,
    Request,
    WallClock,
    Wire,
)
from drivers.messages.scanner import (
    CHUNK,
    Abort,
    BulkRequest,
    Chunk,
    Manifest,
    Open,
    Read,
    Receipt,
    Release,
    ScanDone,
    ScanId,
    ScannerIdentity,
    ScannerRequest,
    ScanStatus,
    SelfTest,
    SelfTested,
    Sha256,
    Take,
)

__all__ = [
    "CHUNK",
    "MAX_MAP_CELLS",
    "MAX_MESSAGE",
    "MAX_SCAN",
    "PROTOCOL",
    "Abort",
    "AcquireLease",
    "AnyReply",
    "BaseIdentity",
    "BaseRequest",
    "Beat",
    "Body",
    "BulkRequest",
    "Chunk",
    "Command",
    "Count",
    "Drive",
    "DriveDone",
    "DriveStatus",
    "Finite",
    "Fraction",
    "Goal",
    "GoalId",
    "Identify",
    "Late",
    "LeaseGranted",
    "LeaseNumber",
    "Manifest",
    "Name",
    "Nonce",
    "Ok",
    "Open",
    "Owner",
    "Pending",
    "Pose",
    "Problem",
    "Query",
    "Read",
    "Receipt",
    "Release",
    "ReleaseLease",
    "Reply",
    "Request",
    "RobotMap",
    "ScanDone",
    "ScanId",
    "ScanStatus",
    "ScannerIdentity",
    "ScannerRequest",
    "SelfTest",
    "SelfTested",
    "Sha256",
    "Stale",
    "Stop",
    "Take",
    "Telemetry",
    "Unknown",
    "WallClock",
    "Wire",
]

AnyReply = (
    Ok
    | Pending
    | Unknown
    | Stale
    | Late
    | Problem
    | ScannerIdentity
    | BaseIdentity
    | SelfTested
    | LeaseGranted
    | ScanDone
    | Manifest
    | Chunk
    | DriveDone
)
