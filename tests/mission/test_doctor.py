"""What the doctor makes of a machine where something is amiss."""

import ctypes
import shutil
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from mission import doctor


def finding(what: str) -> doctor.Finding:
    return next(found for found in doctor.examine() if found.what == what)


@pytest.mark.skipif(sys.platform != "linux", reason="the libraries are Linux's")
def test_a_missing_library_comes_with_the_package_that_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def load(name: str) -> None:
        if name == "libEGL.so.1":
            raise OSError(name)

    monkeypatch.setattr(ctypes, "CDLL", load)
    assert finding("libEGL.so.1") == doctor.Finding("libEGL.so.1", False, "missing; apt-get install libegl1")
    assert finding("libGL.so.1").good


def test_a_missing_package_comes_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        if name == "numba":
            raise metadata.PackageNotFoundError(name)
        return "1.0"

    monkeypatch.setattr(metadata, "version", version)
    assert finding("numba") == doctor.Finding("numba", False, "missing; make setup")
    assert finding("numpy").found == "1.0"


def test_either_name_of_open3d_will_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        if name == "open3d-cpu":
            raise metadata.PackageNotFoundError(name)
        return "0.20"

    monkeypatch.setattr(metadata, "version", version)
    assert finding("open3d-cpu") == doctor.Finding("open3d-cpu", True, "0.20")


def test_a_full_disk_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1e9))
    assert not finding("disk").good


def test_agents_that_cannot_be_reached_are_found_by_name(tmp_path: Path) -> None:
    site = tmp_path / "site.yaml"
    nowhere = {"control": "tcp://127.0.0.1:nowhere", "bulk": "tcp://127.0.0.1:nowhere"}
    base = {"control": "tcp://127.0.0.1:nowhere", "telemetry": "tcp://127.0.0.1:1"}
    site.write_text(yaml.safe_dump({"site": "lab", "scanner": nowhere, "base": base}))
    found = {finding.what: finding for finding in doctor.examine(site)}
    assert found[str(site)].good
    assert not any(found[what].good for what in ("scanner", "base", "base telemetry"))
    assert "nowhere" in found["scanner"].found
