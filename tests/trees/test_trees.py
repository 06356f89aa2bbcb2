"""Every tree can be made and drawn without a robot, and none breaks the rules that have bitten somebody."""

import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest
from py_trees.behaviour import Behaviour
from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.composites import Composite, Selector, Sequence
from py_trees.decorators import Decorator, OneShot, Repeat, Retry

from behaviours import asking, driving, safety, scanning
from behaviours.conditions import Condition
from behaviours.freeze import Freeze
from behaviours.job import JobLeaf
from behaviours.keys import Key, access_to
from behaviours.leaf import Leaf
from behaviours.recover import Recover
from behaviours.scanning import StageLeaf
from behaviours.settings import Settings
from trees import building, cycle, errands, locating, recovery, room
from trees import safety as safety_tree
from trees import scanning as scan_trees

TREES: dict[str, Callable[[], Behaviour]] = {
    "mission": building.create_root,
    "building": lambda: building.building(Settings()),
    "next door": lambda: building.next_door(Settings()),
    "home": lambda: errands.go_home(Settings()),
    "enough charge": lambda: errands.enough_charge(Settings()),
    "drive": lambda: errands.drive("drive somewhere", Settings()),
    "located": lambda: locating.located(Settings()),
    "scan here": lambda: scan_trees.scan_here(Settings()),
    "room": lambda: room.room(Settings()),
    "cycles": lambda: room.cycles(Settings()),
    "cycle": lambda: cycle.cycle(Settings()),
    "registered scan": lambda: cycle.registered_scan(Settings()),
    "scan": lambda: cycle.scan(Settings()),
    "place": cycle.place,
    "next view": lambda: cycle.next_view(Settings()),
    "abort": safety_tree.abort,
    "watch": safety_tree.watch,
    "again": recovery.again_if_the_scan_failed,
    "nearby": lambda: errands.move_nearby(Settings()),
    "bridge": lambda: errands.bridge(Settings()),
    "next best": recovery.next_best_instead,
    "another door": recovery.another_door,
}
WRITTEN_BY_THE_EXECUTIVE = {Key.COMMAND, Key.SURVEY}
BOUNDED_BY_THEIR_DRIVER = {
    asking.Ask: "a question that nobody answers takes its default at its deadline",
    scanning.FetchScan: "a transfer resumes while data flows and gives up when it stops",
}


def leaves(root: Behaviour) -> Iterator[Leaf]:
    return (node for node in root.iterate() if isinstance(node, Leaf))


def every_class(of: type) -> set[type]:
    below = set(of.__subclasses__())
    return below.union(*(every_class(kind) for kind in below))


@pytest.mark.parametrize("tree", TREES)
def test_a_tree_is_made_and_drawn_without_a_robot(tree: str) -> None:
    from mission.drawing import as_dot, as_text

    root = TREES[tree]()
    drawn, dot = as_text(root), as_dot(root)
    for node in root.iterate():
        assert node.name in drawn
        assert node.name.replace(":", "") in dot.replace(":", "")


def test_two_trees_share_no_node() -> None:
    first, second = building.create_root(), building.create_root()
    assert not {node.id for node in first.iterate()} & {node.id for node in second.iterate()}


def test_siblings_have_names_of_their_own() -> None:
    """The journal tells nodes by their paths."""
    for node in building.create_root().iterate():
        names = [child.name for child in node.children]
        assert len(names) == len(set(names)), f"{node.name}: {names}"


def test_every_node_below_a_leaf_speaks_the_projects_language() -> None:
    """Leaves of py_trees' own know nothing of typed failures."""
    for node in building.create_root().iterate():
        assert isinstance(node, Leaf | Composite | Decorator), node.name


def test_every_key_that_is_read_is_written_somewhere() -> None:
    root = building.create_root()
    written = {key for leaf in leaves(root) for key in leaf.writes} | WRITTEN_BY_THE_EXECUTIVE | {Key.FAILURE}
    for leaf in leaves(root):
        assert set(leaf.reads) <= written, leaf.name
    assert written == set(Key), "every key in the book is used"


def test_no_key_has_an_exclusive_writer() -> None:
    """Such a leaf could not stand in two trees, nor twice in one."""
    access_to.cache_clear()  # what was declared before this test is not on its blackboard
    building.create_root()
    assert {key for key in Key if Blackboard.metadata[f"/{key}"].exclusive} == set()


@pytest.mark.parametrize("kind", sorted(every_class(JobLeaf), key=lambda kind: kind.__name__))
def test_every_wait_has_an_end(kind: type[JobLeaf]) -> None:
    """By a deadline of its own, by the worker's for each stage, or by the driver's, named here with its reason."""
    own_deadline = kind.timeout is not JobLeaf.timeout
    assert own_deadline or issubclass(kind, StageLeaf) or kind in BOUNDED_BY_THEIR_DRIVER
    assert own_deadline == hasattr(kind, "timeout_code"), "its timeout has a code of its own"


def test_the_waits_that_hold_the_robot_up_have_deadlines_in_the_tree() -> None:
    for kind in (scanning.TakeScan, driving.DriveToTarget, safety.EndMission):
        assert kind.timeout is not JobLeaf.timeout


def test_no_loop_is_without_a_bound_but_those_that_end_with_the_building_a_room_and_its_openings() -> None:
    root = building.create_root()
    assert not [node for node in root.iterate() if isinstance(node, OneShot | Retry)]
    endless = [node.name for node in root.iterate() if isinstance(node, Repeat) and node.num_success < 0]
    assert sorted(endless) == ["every room (again)", "look closer (again)", "while open (again)"]


def test_only_the_root_and_what_matters_most_is_looked_at_afresh_at_every_tick() -> None:
    """A memoryless parent re-runs finished actions, so below one there are conditions, or children with memory."""
    root = building.create_root()
    memoryless = [node for node in root.iterate() if isinstance(node, Sequence | Selector) and not node.memory]
    assert {node.name for node in memoryless} == {"mission", "what matters most", "watch"}
    sense, matters = root.children
    assert isinstance(sense, safety.SenseBase)
    abort, guarded = matters.children
    assert isinstance(abort.children[0], Condition)
    assert isinstance(guarded, Freeze)
    assert (guarded.watch.name, guarded.work.name) == ("watch", "building")
    for branch in guarded.watch.children:
        assert isinstance(branch, safety.Paused) or isinstance(branch.children[0], safety.Hold)


def test_every_recovery_begins_by_asking_whether_it_can_help() -> None:
    for node in building.create_root().iterate():
        if isinstance(node, Recover):
            first = node.recovery.children[0] if node.recovery.children else node.recovery
            assert isinstance(first, Condition), node.name


def test_making_a_tree_runs_nothing() -> None:
    assert {node.status for node in building.create_root().iterate()} == {Status.INVALID}
    assert Blackboard.storage == {}


def test_the_process_that_ticks_imports_neither_open3d_nor_numba() -> None:
    """They take most of a second and hold the interpreter's lock; they belong to the worker."""
    code = (
        "import sys; import mission.executive, mission.worker, mission.journal, trees.building; "
        "trees.building.create_root(); "
        "print([name for name in ('open3d', 'numba', 'cv2', 'matplotlib') if name in sys.modules])"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert told.stdout.strip() == "[]"
