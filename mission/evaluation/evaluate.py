"""The figures of a run against its world, and where they are kept."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from drivers.simulated.truth_log import read_truth
from drivers.simulated.world import World, read_world
from drivers.simulated.worlds import load_world
from drivers.simulated.worlds.free_space import reachable
from mission.evaluation import areas, survey
from mission.evaluation.settings import EvaluationSettings
from mission.report.run import EVALUATION, read_run
from mission.store import RunFolder, write_text


@dataclass(frozen=True)
class Evaluation:
    """Figures of a run against its world; shares in [0, 1], None where the world has no truth to compare with.

    Args:
        pose_error_max_m, pose_error_max_deg: over the accepted scans, relative to the first.
        sensed_fraction: sensed share of the walls, floors and ceilings of all reachable rooms.
        coverable_fraction: share of them that the scanner could see from where the base can stand, C*.
        sensed_of_coverable: sensed share of C*.
        doors_precision: share of the found doors that are open doors; 1 where none was found.
        doors_recall: share of the passable doors between rooms, beside a reachable one, that were found.
        rooms: each true room, whether it can be reached and whether it was finished.
        table_2: areas by room and element, the last row the total.
        poses: error of each accepted scan.
        doors: found, true and missed doors by id.
    """

    rooms_reachable: int
    rooms_finished: int
    scans: int
    collisions: int
    pose_error_max_m: float | None
    pose_error_max_deg: float | None
    sensed_fraction: float | None
    coverable_fraction: float | None
    sensed_of_coverable: float | None
    doors_precision: float
    doors_recall: float
    rooms: list[dict[str, Any]] = field(default_factory=list)
    table_2: list[dict[str, Any]] = field(default_factory=list)
    poses: list[dict[str, Any]] = field(default_factory=list)
    doors: dict[str, list[str]] = field(default_factory=dict)
    settings: EvaluationSettings = field(default_factory=EvaluationSettings)

    def summary(self) -> dict[str, Any]:
        """The figures that ``mission evaluate --json`` prints, by their fixed names."""
        return {name: getattr(self, name) for name in _SUMMARY}

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready, every figure by its name."""
        return asdict(self)


_SUMMARY = (
    "rooms_reachable",
    "rooms_finished",
    "scans",
    "collisions",
    "pose_error_max_m",
    "pose_error_max_deg",
    "sensed_fraction",
    "coverable_fraction",
    "sensed_of_coverable",
    "doors_precision",
    "doors_recall",
)


def evaluate_run(folder: Path, world: str | None = None, settings: EvaluationSettings | None = None) -> Evaluation:
    """Evaluate a run and keep the figures in its folder, where the report finds them.

    Args:
        folder: the run folder.
        world: the building, by a name or a file as ``mission simulate`` takes it (with the seed of the run); by
            default the very one that the run was simulated in.

    Raises:
        FailureError: ``RUN_UNREADABLE``, ``WORLD_UNREADABLE`` and what :func:`load_world` raises.
    """
    evaluation = evaluate(folder, _world(RunFolder(folder), world), settings)
    write_text(folder / EVALUATION, json.dumps(evaluation.to_dict(), indent=1) + "\n")
    return evaluation


def evaluate(folder: Path, world: World, settings: EvaluationSettings | None = None) -> Evaluation:
    """Compare a run with the world it took place in.

    The map frame hangs on the first scan: its true pose fixes where the map lies in the world, and every other pose
    is judged relative to it.

    Args:
        folder: the run folder, with what the simulated agents wrote under ``simulation/``.
        world: the building.

    Raises:
        FailureError: ``RUN_UNREADABLE`` if the folder holds no run.
    """
    settings = settings or EvaluationSettings()
    run = read_run(folder)
    events = read_truth(RunFolder(run.folder).simulation)
    true_poses = survey.true_poses(run, events)
    world_from_map = survey.world_from_map(run, true_poses)
    in_reach = reachable(world)
    finished = survey.finished_rooms(run, world_from_map, world, in_reach, settings.room_share)
    poses = survey.pose_errors(run, world_from_map, true_poses)
    doors = survey.match_doors(run, world_from_map, world, in_reach, settings.door_match_m)
    table = areas.table_2(run, world_from_map, world, in_reach, settings)
    total = table[-1]["total"] if table else {}
    return Evaluation(
        rooms_reachable=len(in_reach),
        rooms_finished=len(finished),
        scans=max(len(true_poses), len(run.scans)),
        collisions=sum(event["event"] == "collision" for event in events),
        pose_error_max_m=max((pose["error_m"] for pose in poses), default=None),
        pose_error_max_deg=max((pose["error_deg"] for pose in poses), default=None),
        sensed_fraction=total.get("share"),
        coverable_fraction=total.get("coverable_share"),
        sensed_of_coverable=total.get("of_coverable"),
        doors_precision=_share(len(doors["right"]), len(doors["found"])),
        doors_recall=_share(len(doors["expected"]) - len(doors["missed"]), len(doors["expected"])),
        rooms=[
            {"room": room.room_id, "reachable": room.room_id in in_reach, "finished": room.room_id in finished}
            for room in world.truth.rooms
        ],
        table_2=table,
        poses=poses,
        doors=doors,
        settings=settings,
    )


def _world(run: RunFolder, spec: str | None) -> World:
    if spec is None:
        return read_world(run.simulation / "world.npz")
    plan: dict[str, Any] = json.loads(run.rehearsal.read_text()) if run.rehearsal.exists() else {}
    options = plan["options"] if plan.get("world") == spec else {}
    return load_world(spec, plan.get("seed", 0), **options)


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 1.0
