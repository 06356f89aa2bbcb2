"""Processes told by more than their number, which another one may have by the time that it is read."""

from pathlib import Path


def birth_of(pid: int) -> str:
    """When a living process began, in which life of this computer; empty where there is none of that number."""
    try:
        computer = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        # After the name, which may hold anything: the state, and as the twentieth the time when it began.
        state, *figures = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()
    except (OSError, ValueError):
        return ""
    return "" if state in ("Z", "X") else f"{computer} {figures[18]}"


def lives(pid: int, birth: str) -> bool:
    """Whether the process of this number is still the one that was born then."""
    return bool(birth) and birth_of(pid) == birth
