"""All stages at five million points a scan in one table: ``make bench``, or ``python -m benchmarks``."""

from collections.abc import Iterator

from benchmarks import ingest, registration, stages
from benchmarks.data import STATIONS, placed
from benchmarks.timing import HEAD, table

_OF_RECEIVING = {"paper": "-", "bar": f"{ingest.BAR_S}"}
_OF_REGISTERING = {"paper": "< 6", "bar": "1.0; 0.7 x Open3D, 1.0 x small_gicp"}


def main() -> None:
    print(table([*_receiving(), *_registering(), *(row.cells() for row in stages.rows())]))


def _receiving() -> Iterator[list[str]]:
    for row in ingest.rows(placed(STATIONS[0], "S01").scan):
        ours = row.step == ingest.OURS
        found = {"stage": row.step, "ours: wall s": f"{row.median:.3f}", "": f"worst {row.worst:.3f}"}
        yield _cells(found | (_OF_RECEIVING if ours else {}))


def _registering() -> Iterator[list[str]]:
    found = registration.rows()
    own = found[0]
    for row in found:
        errors = f"error {row['error_mm']:.2f} mm, {row['error_deg']:.4f}°"
        common = {"stage": "register to P(t-1)", "": errors} | _OF_REGISTERING
        if row["contender"].startswith("ours"):
            mine = {"ours: wall s": f"{row['wall_s']:.3f}", "processor s": f"{row['processor_s']:.3f}"}
            yield _cells(common | mine | {"alternative": row["contender"], "peak MB": _megabytes(row)})
        else:
            theirs = {"alternative": row["contender"], "its wall s": f"{row['wall_s']:.3f}"}
            ratio = {"ours : it": f"{own['wall_s'] / row['wall_s']:.2g}", "peak MB": _megabytes(own)}
            yield _cells(common | {"ours: wall s": f"{own['wall_s']:.3f}"} | theirs | ratio)


def _megabytes(row: dict[str, object]) -> str:
    return "" if row["peak_mb"] is None else f"{row['peak_mb']:.0f}"


def _cells(found: dict[str, str]) -> list[str]:
    return [found.get(name, "") for name in HEAD]


if __name__ == "__main__":
    main()
