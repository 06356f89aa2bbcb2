"""Puts figures and pictures together: ``report.json`` for machines, ``report.html`` for the surveyor."""

import base64
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

from mission.report import pictures, tables, timing, watch
from mission.report.recorded import recorded
from mission.report.run import Run, read_run
from mission.store import RunFolder, write_text

Report = dict[str, Any]


def write_report(folder: Path) -> Path:
    """Write ``report.html``, ``report.json`` and the pictures of a run, finished or broken off.

    Returns:
        Path of ``report.html``: one file that asks for nothing else.

    Raises:
        FailureError: ``RUN_UNREADABLE`` if the folder holds no run, ``DISK_FULL``, ``IO_ERROR``.
    """
    run = read_run(folder)
    report = collect(run)
    drawn = pictures.draw_all(run)
    report["pictures"] = [str(picture.path.relative_to(run.folder)) for picture in drawn]
    write_text(run.folder / "report.json", json.dumps(report, indent=1, default=str) + "\n")
    page = RunFolder(folder).report
    write_text(page, render(report, drawn))
    return page


def collect(run: Run) -> Report:
    """All figures of the report, JSON-ready."""
    return {
        "summary": tables.outcome(run),
        "table_1": tables.table_1(run),
        "evaluation": dict(run.evaluation) if run.evaluation else None,
        "rooms": tables.rooms(run),
        "left_out": tables.left_out(run),
        "recorded": recorded(run),
        "registrations": tables.registrations(run),
        "registration_limits": tables.LIMITS,
        "pose_graph": tables.pose_graph(run),
        "doors": tables.doors(run),
        "openings": tables.openings(run),
        "times": timing.times(run),
        "failures": tables.failures(run),
        "recoveries": tables.recoveries(run),
        "questions": watch.questions(run),
        "interruptions": watch.interruptions(run),
    }


def render(report: Report, drawn: list[pictures.Picture]) -> str:
    """The page for :func:`collect`'s figures and the pictures drawn."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    filters: dict[str, Callable[..., str]] = {
        "number": number,
        "share": share,
        "millimetres": lambda value: number(value, 1, scale=1e3),
        "degrees": lambda value: number(value, 3, scale=180 / math.pi),
        "duration": duration,
        "precise": lambda value: duration(value) if value is None or value >= 60 else f"{value:.2f}\u202fs",
        "embed": embed,
    }
    environment.filters.update(filters)
    by_kind = {kind: [picture for picture in drawn if picture.kind == kind] for kind in pictures.KINDS}
    return environment.get_template("report.html").render(report | {"pictures": by_kind})


def number(value: float | None, digits: int = 0, scale: float = 1.0) -> str:
    """A figure with thin spaces between thousands; an en dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value * scale:,.{digits}f}".replace(",", "\u202f")


def share(value: float | None, digits: int = 1) -> str:
    """A share in [0, 1] in per cent."""
    return "–" if value is None else f"{100 * value:.{digits}f}\u202f%"


def duration(seconds: float | None) -> str:
    """Seconds as hours, minutes and seconds."""
    if seconds is None:
        return "–"
    if seconds < 60:
        return f"{seconds:.1f}\u202fs"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}\u202fh {minutes:02d}\u202fmin" if hours else f"{minutes}\u202fmin {rest:02d}\u202fs"


def embed(path: Path) -> str:
    """A picture as a data URL."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
