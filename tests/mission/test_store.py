"""The run folder: names, and files that are whole or not there."""

import errno
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mission import store
from mission.store import RunFolder
from perception.failure import FailureError
from perception.grids import Cell, Grid, Label, VoxelSpace


def test_missions_of_the_same_second_get_folders_of_their_own(tmp_path: Path) -> None:
    folders = [RunFolder.create(tmp_path / "runs", "school-0").path for _ in range(4)]
    assert len(set(folders)) == 4
    assert all("school-0" in folder.name for folder in folders)
    assert all((folder / "scans").is_dir() for folder in folders)


def test_a_folder_that_is_there_is_opened_with_what_it_holds(tmp_path: Path) -> None:
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "S01.scan").write_text("x")
    run = RunFolder.at(tmp_path)
    assert run.scan_file("S01").read_text() == "x"
    assert {path.name for path in tmp_path.iterdir()} == {"scans", "maps", "voxels", "evidence", "pictures"}


def test_no_two_things_share_a_file(tmp_path: Path) -> None:
    run = RunFolder.at(tmp_path)
    files = [
        run.events, run.config, run.state, run.simulation, run.scan_file("S01"), run.map_file("M"),
        run.map_evidence_file("M"), run.voxel_file("R1", 1), run.voxel_file("R1", 2), run.voxel_file("R2", 1),
        run.evidence_file("R1", 1, "view"), run.evidence_file("R1", 1, "ceiling"),
    ]  # fmt: skip
    assert len(set(files)) == len(files)


def test_the_state_is_json_whatever_its_figures_are_made_of(tmp_path: Path) -> None:
    run = RunFolder.at(tmp_path)
    run.write_state({"pose": np.eye(2), "points": np.int64(3), "share": np.float32(0.5), "file": Path("a")})
    assert json.loads(run.state.read_text()) == {"pose": [[1, 0], [0, 1]], "points": 3, "share": 0.5, "file": "a"}


@pytest.mark.parametrize("text", ['{"rooms": 1}', "rooms: 1"], ids=["json", "yaml"])
def test_names_and_values_are_read_back(text: str, tmp_path: Path) -> None:
    (tmp_path / "a").write_text(text)
    assert store.read_mapping(tmp_path / "a", json.loads if text.startswith("{") else yaml.safe_load) == {"rooms": 1}


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (None, "cannot be read: .*No such file"),
        (b'{"rooms": ', "cannot be read: Expecting value"),
        (b"\xff", "cannot be read: .*utf-8"),
        (b"[1, 2]", r"expected names and values, found \[1, 2\]"),
        (b"null", "expected names and values, found None"),
    ],
)
def test_a_file_that_says_no_names_and_values_is_named(content: bytes | None, why: str, tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FailureError, match=rf"RUN_UNREADABLE.*state\.json.*{why}"):
        store.read_mapping(path)


def test_a_file_that_is_no_yaml_is_named(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("a: [")
    with pytest.raises(FailureError, match=r"RUN_UNREADABLE.*config\.yaml cannot be read"):
        store.read_mapping(tmp_path / "config.yaml", yaml.safe_load)


def test_what_cannot_be_written_leaves_the_old_file(tmp_path: Path) -> None:
    run = RunFolder.at(tmp_path)
    run.write_state({"rooms": 1})
    with pytest.raises(TypeError):
        run.write_state({"rooms": object()})
    assert json.loads(run.state.read_text()) == {"rooms": 1}


def test_a_writer_that_is_cut_off_is_never_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.npz"
    store.write_arrays(path, a=[1, 2])

    def cut_off(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, "the disk is broken")

    monkeypatch.setattr(np, "savez_compressed", cut_off)
    with pytest.raises(FailureError, match=r"IO_ERROR.*a\.npz"):
        store.write_arrays(path, a=[3])
    assert store.read_arrays(path)["a"].tolist() == [1, 2]


def test_two_processes_that_write_the_same_file_do_not_mix_what_they_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.txt"
    with store.whole_file(path) as ours:
        ours.write_text("ours")
        with monkeypatch.context() as elsewhere:
            elsewhere.setattr("os.getpid", lambda: 1)
            store.write_text(path, "theirs, longer", durably=False)
        assert path.read_text() == "theirs, longer"
    assert path.read_text() == "ours"
    assert list(tmp_path.iterdir()) == [path]


def test_arrays_that_would_execute_something_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "evil.npz"
    np.savez(path, a=np.array([{"a": 1}], dtype=object))
    with pytest.raises(FailureError, match=r"RUN_LOSSY.*evil\.npz.*pickle"):
        store.read_arrays(path)


def test_arrays_whose_file_is_damaged_or_missing_are_refused_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    store.write_arrays(path, labels=np.arange(2000), origin=[1.0, 2.0])
    whole = path.read_bytes()
    kept = store.read_arrays(path)
    refused = 0
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        try:
            found = store.read_arrays(path)
        except FailureError as error:
            assert str(error).startswith("RUN_LOSSY") and str(path) in str(error)
            refused += 1
        else:  # a time stamp, or the like, of which the arrays are not made
            assert all(np.array_equal(found[name], kept[name]) for name in kept.keys() & found.keys()), place
    assert refused > 0.8 * len(whole)
    np.save(path.with_suffix(".npy"), np.arange(3))
    for missing in (tmp_path / "none.npz", path.with_suffix(".npy")):
        with pytest.raises(FailureError, match=f"RUN_LOSSY.*{missing.name}"):
            store.read_arrays(missing)


@given(
    arrays.arrays(np.uint8, st.tuples(st.integers(1, 6), st.integers(1, 6)), elements=st.sampled_from(list(Cell))),
    st.tuples(st.floats(-50, 50), st.floats(-50, 50)),
)
def test_grids_load_back(tmp_path_factory: pytest.TempPathFactory, data: np.ndarray, origin: tuple) -> None:
    path = tmp_path_factory.getbasetemp() / "grid.npz"
    store.save_grid(path, Grid(data, origin, 0.05))
    grid = store.load_grid(path)
    np.testing.assert_array_equal(grid.data, data)
    assert (grid.origin, grid.resolution) == (origin, 0.05)


def test_voxel_spaces_load_back(tmp_path: Path) -> None:
    labels = np.random.default_rng(1).choice(list(Label), (3, 4, 5)).astype(np.uint8)
    store.save_space(tmp_path / "space.npz", VoxelSpace(labels, (-1.0, 2.0, 0.5), 0.1))
    space = store.load_space(tmp_path / "space.npz")
    np.testing.assert_array_equal(space.labels, labels)
    assert (space.origin, space.size) == ((-1.0, 2.0, 0.5), 0.1)
