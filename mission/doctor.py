"""Looks whether a machine is fit for a mission, before anything moves: each finding with what to do about it."""

import ctypes
import shutil
import sys
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from mission.finding import Finding

if TYPE_CHECKING:
    from mission.config import SiteConfig

_LIBRARIES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libusb-1.0.so.0": "libusb-1.0-0",
}
_PACKAGES = ("open3d-cpu", "py-trees", "numpy", "scipy", "opencv-python-headless", "pyzmq", "numba", "pye57")
_DISK_GB = 5.0
_PATIENCE_S = 15.0


def examine(site: Path | None = None) -> list[Finding]:
    """Everything about this machine, and about a site's agents where its configuration is given."""
    findings = [_python(), *_libraries(), *_packages(), _disk()]
    return findings if site is None else [*findings, *_site(site)]


def _python() -> Finding:
    version = sys.version.split()[0]
    good = sys.version_info >= (3, 11)
    return Finding("Python", good, version if good else f"{version}; expected 3.11 or newer")


def _libraries() -> list[Finding]:
    # Before Open3D is imported: its own message does not say which package is missing.
    return [_library(name, package) for name, package in _LIBRARIES.items()] if sys.platform == "linux" else []


def _library(name: str, package: str) -> Finding:
    try:
        ctypes.CDLL(name)
    except OSError:
        return Finding(name, False, f"missing; apt-get install {package}")
    return Finding(name, True, "present")


def _packages() -> list[Finding]:
    return [_package(name) for name in _PACKAGES]


def _package(name: str) -> Finding:
    for alias in (name, name.removesuffix("-cpu")):
        try:
            return Finding(name, True, metadata.version(alias))
        except metadata.PackageNotFoundError:
            continue
    return Finding(name, False, "missing; make setup")


def _disk() -> Finding:
    free = shutil.disk_usage(Path.cwd()).free / 1e9
    return Finding("disk", free > _DISK_GB, f"{free:.0f} GB free of {_DISK_GB:.0f} GB needed")


def _site(site: Path) -> list[Finding]:
    from mission.config import ConfigError, load_config

    try:
        config = load_config(site)
    except ConfigError as error:
        return [Finding(str(site), False, str(error))]
    return [Finding(str(site), True, f"site {config.site}"), *_agents(config)]


def _agents(config: "SiteConfig") -> list[Finding]:
    from drivers.wire.base_client import BaseClient
    from drivers.wire.scanner_client import ScannerClient
    from mission.keys import sockets_to
    from mission.preflight import inspect, lease, meet
    from perception.failure import FailureError

    try:
        scans = ScannerClient(config.scanner, sockets=sockets_to(config, config.scanner))
        drives = BaseClient(config.base, sockets=sockets_to(config, config.base))
    except FailureError as error:
        return [Finding("keys", False, str(error))]
    answers = meet(scans, drives, _PATIENCE_S)
    drives.close()
    return [*inspect(config, answers, Path.cwd()), *lease(answers.state)]
