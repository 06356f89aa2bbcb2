"""Every failure code of the program has its row in the operator's guide, and a test that expects it.

A code that a mission can meet is expected in a scenario or an end-to-end mission, all others in a test of any kind.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FLOORS = ("perception", "drivers", "behaviours", "trees", "mission")
GUIDE = ROOT / "docs" / "operations.md"
FAILURES = frozenset({"FailureError", "Failure", "Problem"})
CODE = re.compile(r"[A-Z][A-Z0-9_]{3,}")
NO_SCENARIO = {
    "BAD_TRANSFORM": "decoding a message refuses it; the mission meets BAD_MESSAGE",
    "AUTHENTICATOR_DIED": "ends the agent's process; the mission meets an agent that is gone",
    "BUILDING_": "the graph of rooms is asked for one that it never had: an error of the program, not of a day",
    "LEAF_STATUS": "no leaf of the tree gives no status: the base leaf guards those that are still to be written",
    "REG_NO_GUESS": "only the very first scan has no guess, and that one is anchored, not registered",
    "NO_DOOR_LEFT": "the orderly end of a loop, which no log and no report calls a failure",
    "NO_SUSPECT_LEFT": "the orderly end of a loop, which no log and no report calls a failure",
    "COVERAGE_": "the evaluation's, after a mission",
    "EXPORT_": "of a command on a run folder, after a mission",
    "MAP_UNREADABLE": "of a program that reads an exported map, after a mission",
    "RUN_UNREADABLE": "of commands that open a run folder before a mission",
    "LEDGER_IN_USE": "of the start: the mission is run already, and nothing of this one begins",
    "MISSION_ENDED": "of `mission resume`, where there is nothing to go on with",
    "MISSION_ENDING": "told to an operator whose word comes too late; the mission does not meet it",
    "EXECUTIVE_SILENT": "told to an operator by a command",
    "NO_EXECUTIVE": "told to an operator by a command",
    "NO_SUCH_": "told to an operator by a command",
    "ENDPOINT_": "of an agent's start",
    "KEY_": "of the commands for keys",
    "KEYS_": "of the commands for keys, and of an agent's start",
    "NAME_": "of the commands for keys",
    "ROLE_INVALID": "of the commands for keys",
    "TOO_MANY_KEYS": "of the commands for keys",
    "RECORDED_": "of `mission process`, which drives nothing",
    "ORIGIN_UNKNOWN": "of `mission process`, which drives nothing",
    "PROFILE_UNKNOWN": "of a simulation's start",
    "WORLD_": "of a simulation's start",
}
"""Codes, and prefixes that end with ``_``, for which a unit test suffices; and why."""
Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def modules() -> list[ast.Module]:
    paths = [path for floor in FLOORS for path in sorted((ROOT / floor).rglob("*.py"))]
    return [ast.parse(path.read_text(encoding="utf-8")) for path in paths]


@cache
def parts_of(tree: ast.AST) -> list[ast.AST]:
    return list(ast.walk(tree))


def name_of(call: ast.Call) -> str:
    return getattr(call.func, "id", None) or getattr(call.func, "attr", "")


def codes_given(tree: ast.AST, makers: frozenset[str]) -> Iterator[ast.expr]:
    """What stands where a failure, or whatever makes one, takes its code."""
    for node in parts_of(tree):
        if isinstance(node, ast.Call) and node.args and name_of(node) in makers:
            yield node.args[0]
        elif isinstance(node, ast.Dict):  # a row of the journal that tells a failure without making one
            yield from (value for key, value in zip(node.keys, node.values, strict=True) if is_code_key(key))


def is_code_key(key: ast.expr | None) -> bool:
    return isinstance(key, ast.Constant) and key.value == "code"


def passes_on(function: Function, makers: frozenset[str]) -> bool:
    """Whether a function hands its first parameter on as a code."""
    parameters = [argument.arg for argument in function.args.args if argument.arg != "self"]
    given = {node.id for node in codes_given(function, makers) if isinstance(node, ast.Name)}
    return bool(parameters) and parameters[0] in given


def makers_in(tree: ast.Module, elsewhere: frozenset[str]) -> frozenset[str]:
    """The names by which a module may make a failure, its own functions that pass a code on among them."""
    makers = elsewhere
    functions = [node for node in parts_of(tree) if isinstance(node, Function)]
    while more := {one.name for one in functions if passes_on(one, makers)} - makers:
        makers |= more
    return makers


@cache
def public_makers() -> frozenset[str]:
    found = frozenset().union(*(makers_in(tree, FAILURES) for tree in modules()))
    return FAILURES | {name for name in found if not name.startswith("_")}


def constants(node: ast.expr) -> Iterator[str]:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.IfExp):
        yield from constants(node.body)
        yield from constants(node.orelse)


def assigned(tree: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    for node in parts_of(tree):
        if isinstance(node, ast.Assign):
            yield from ((target.id, node.value) for target in node.targets if isinstance(target, ast.Name))
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value:
            yield node.target.id, node.value


@cache
def codes() -> frozenset[str]:
    """All codes of the five floors: given as such, or through a name or a class attribute that is given."""
    found: set[str] = set()
    attributes: set[str] = set()
    for tree in modules():
        given = list(codes_given(tree, makers_in(tree, public_makers())))
        names = {node.id for node in given if isinstance(node, ast.Name)}
        attributes |= {node.attr for node in given if isinstance(node, ast.Attribute)}
        found.update(code for node in given for code in constants(node))
        found.update(code for name, value in assigned(tree) if name in names for code in constants(value))
    for tree in modules():
        for node in parts_of(tree):
            if isinstance(node, ast.ClassDef):
                body = (part for line in node.body for part in assigned(line) if not isinstance(line, Function))
                found.update(code for name, value in body if name in attributes for code in constants(value))
    return frozenset(code for code in found if CODE.fullmatch(code))


@cache
def rows() -> list[tuple[list[str], list[str]]]:
    """Codes and further cells of each row in the guide's section on them."""
    section = re.split(r"^## ", GUIDE.read_text(encoding="utf-8").partition("\n## Failure codes\n")[2], flags=re.M)[0]
    lines = [line.strip().strip("|").split(" | ") for line in section.splitlines() if line.startswith("| `")]
    return [(re.findall(r"`([A-Z0-9_]+)`", first), rest) for first, *rest in lines]


@cache
def expected_in_tests(*folders: str) -> frozenset[str]:
    """Codes in what a test asserts, in what it wants an exception to match, and in its parameters.

    Of the tests in some folders, or of all. A code that a test only hands to the program, or has in its docstring, is
    not expected by it.
    """
    places = [ROOT / "tests" / folder for folder in folders] or [ROOT / "tests"]
    paths = [path for place in places for path in place.rglob("*.py") if path != Path(__file__)]
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in paths]
    said = [part for tree in trees for node in ast.walk(tree) for part in expectations(node)]
    words = [node.value for part in said for node in ast.walk(part) if isinstance(node, ast.Constant)]
    return frozenset(code for value in words if isinstance(value, str) for code in CODE.findall(value))


def expectations(node: ast.AST) -> list[ast.AST]:
    if isinstance(node, ast.Assert):
        return [node.test]
    if not isinstance(node, ast.Call):
        return []
    if name_of(node) == "parametrize":
        return [*node.args]
    return [keyword.value for keyword in node.keywords if keyword.arg == "match"]


def belongs(code: str, name: str) -> bool:
    """Whether a code is the one of this name, or of its family."""
    return code == name or (name.endswith("_") and code.startswith(name))


def needs_no_scenario(code: str) -> bool:
    return any(belongs(code, name) for name in NO_SCENARIO)


def test_codes_are_found_however_they_reach_their_failure() -> None:
    """A literal, a gate of its own, a gate elsewhere, a choice, a name, an attribute, a row: one of each."""
    ways = {"NAV_NO_PATH", "REG_INCONSISTENT", "SCAN_TRUNCATED", "NAV_BLOCKED", "SCAN_MOVED", "DISK_FULL"}
    assert ways | {"NAV_TIMEOUT", "ESTOP", "TICK_EXCEPTION"} <= codes()
    assert len(codes()) > 100


@pytest.mark.parametrize("code", sorted(codes()))
def test_each_code_is_explained_and_expected(code: str) -> None:
    assert [code in named for named, _ in rows()].count(True) == 1, "it needs one row in docs/operations.md"
    assert code in expected_in_tests(), "it needs a test"


@pytest.mark.parametrize("code", sorted(code for code in codes() if not needs_no_scenario(code)))
def test_each_code_that_a_mission_can_meet_is_expected_in_a_mission(code: str) -> None:
    assert code in expected_in_tests("scenarios", "missions"), "it needs a scenario, or a reason in NO_SCENARIO"


def test_what_needs_no_scenario_exists_and_has_none() -> None:
    """A reason that is none any more goes."""
    in_missions = expected_in_tests("scenarios", "missions")
    for name in NO_SCENARIO:
        family = {code for code in codes() if belongs(code, name)}
        assert family, f"{name} is no code"
        assert family - in_missions, f"{name} has a scenario by now"


def test_the_guide_knows_no_code_that_does_not_exist() -> None:
    assert {code for named, _ in rows() for code in named} - codes() == set()


def test_each_row_says_what_it_means_what_happens_and_what_to_do() -> None:
    assert [named for named, rest in rows() if len(rest) != 3 or not all(cell.strip(" |") for cell in rest)] == []
