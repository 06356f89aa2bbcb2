"""Scans that somebody else took, read from files: one module a format, and the beams that the points came by."""

from drivers.recorded.beams import scan_of
from drivers.recorded.folder import SUFFIXES, files_of, read_file
from drivers.recorded.raw import Lattice, RawScan

__all__ = ["SUFFIXES", "Lattice", "RawScan", "files_of", "read_file", "scan_of"]
