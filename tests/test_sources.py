"""What no line of the program may do: make a socket of its own, execute data, or leave the folder it writes in."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.messages import ScanId
from drivers.wire.spool import Spool
from mission.store import RunFolder

ROOT = Path(__file__).parent.parent
PACKAGES = ("perception", "drivers", "behaviours", "trees", "mission")
EXECUTES = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "joblib", "jsonpickle", "code"}
LISTENS = {"socketserver", "http.server", "xmlrpc", "asyncio", "multiprocessing.managers", "wsgiref", "ssl"}
CALLS = {"eval", "exec", "compile", "system", "popen", "mktemp", "recv_pyobj", "send_pyobj", "unsafe_load", "full_load"}
SOCKET_MAKERS = {"drivers/wire/sockets.py"}
SOCKET_MODULE = {
    "mission/watchdog.py",  # tells systemd, on the address that systemd gave, and hears nothing
    "mission/ownership.py",  # the name of this computer
}


@cache
def sources() -> list[tuple[str, ast.Module]]:
    paths = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    return [(str(path.relative_to(ROOT)), ast.parse(path.read_text(encoding="utf-8"))) for path in paths]


def imported(tree: ast.Module) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def calls(tree: ast.Module) -> Iterator[tuple[str, str, ast.Call]]:
    """Each call as (what it is called on, its name, the node)."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            if isinstance(node.func, ast.Attribute):
                yield ast.unparse(node.func.value), node.func.attr, node
            elif isinstance(node.func, ast.Name):
                yield "", node.func.id, node


def keyword(node: ast.Call, name: str) -> object:
    """Its value; True for one that is computed."""
    values = [word.value for word in node.keywords if word.arg == name]
    return next((value.value if isinstance(value, ast.Constant) else True for value in values), None)


def sockets_made(tree: ast.Module) -> list[str]:
    return [f"{on}.{name}" for on, name, _ in calls(tree) if name in ("Context", "socket") and on != "socket"] + [
        "create_server" for _, name, _ in calls(tree) if name in ("create_server", "create_connection", "socketpair")
    ]


def dangers(tree: ast.Module) -> list[str]:
    found = [name for name in imported(tree) if name.split(".")[0] in EXECUTES]
    for on, name, node in calls(tree):
        if name in CALLS and on not in ("re", "regex"):
            found.append(f"{on}.{name}")
        if name == "load" and on == "yaml":
            found.append("yaml.load")
        if name == "load" and on in ("np", "numpy") and keyword(node, "allow_pickle") is not False:
            found.append("np.load")
        if keyword(node, "shell"):
            found.append("shell=True")
    return found


def test_sockets_are_made_in_one_place_only():
    made = {name: sockets_made(tree) for name, tree in sources()}
    assert set(SOCKET_MAKERS) <= set(made)
    assert {name: found for name, found in made.items() if found and name not in SOCKET_MAKERS} == {}


def test_nothing_else_listens_or_speaks_to_a_network():
    for name, tree in sources():
        modules = imported(tree)
        assert not modules & LISTENS, name
        assert "socket" not in modules or name in SOCKET_MODULE, name


def test_nothing_that_was_read_is_ever_executed():
    assert {name: found for name, tree in sources() if (found := dangers(tree))} == {}


@pytest.mark.parametrize(
    "line",
    [
        "import pickle",
        "from pickle import loads",
        "yaml.load(text, Loader)",
        "np.load(path)",
        "np.load(path, allow_pickle=True)",
        "eval(text)",
        "socket.recv_pyobj()",
        "subprocess.run(command, shell=True)",
        "os.system(command)",
    ],
)
def test_the_search_finds_what_it_looks_for(line):
    assert dangers(ast.parse(line))


@pytest.mark.parametrize("line", ["zmq.Context()", "zmq.Context.instance().socket(zmq.SUB)", "context.socket(3)"])
def test_the_search_finds_sockets(line):
    assert sockets_made(ast.parse(line))


@settings(max_examples=50, deadline=None)
@given(name=st.from_regex(ScanId.__metadata__[0].pattern))
def test_a_name_from_the_wire_never_leads_out_of_its_folder(tmp_path_factory, name):
    folder = tmp_path_factory.getbasetemp() / "names"
    spool, run = Spool(folder / "spool"), RunFolder(folder / "run")
    assert spool._data(name).resolve().parent == (folder / "spool").resolve()
    assert spool._note(name).resolve().parent == (folder / "spool").resolve()
    assert run.scan_file(name).resolve().parent == (folder / "run" / "scans").resolve()
