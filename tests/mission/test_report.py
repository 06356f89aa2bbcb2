"""The report of a small run: its figures, its words, its pictures, and that it asks for nothing from outside."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.simulated.world import save_world
from mission.evaluation import EvaluationSettings, evaluate_run
from mission.report import read_run, tables, timing, write_report
from mission.report.build import duration, number, share
from perception.failure import FailureError
from tests.mission.fake_run import FakeRun, write_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> FakeRun:
    made = write_run(tmp_path_factory.mktemp("report"))
    save_world(made.world, made.folder / "simulation" / "world.npz")
    evaluate_run(made.folder, settings=EvaluationSettings(station_step_m=2.0))
    write_report(made.folder)
    return made


def page(run: FakeRun) -> str:
    return (run.folder / "report.html").read_text()


class Text(HTMLParser):
    """The words of a page, and the tags that were left open."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.words, self.open = "", []
        self.feed(source)

    def handle_starttag(self, tag: str, attrs: list) -> None:
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.words += data


def test_the_page_is_one_file_that_asks_for_nothing(run: FakeRun) -> None:
    source = page(run)
    assert set(re.findall(r'(?:src|href)="([^"#]{0,11})', source)) - {""} == {"data:image/"}
    assert not re.search(r"https?://|url\(|@import|<script|<link", source)
    assert Text(source).open == []


def test_the_page_says_how_it_ended_and_why(run: FakeRun) -> None:
    words = " ".join(Text(page(run)).words.split())
    assert "1 of 2 rooms finished with 3 scans" in words
    assert "no place is left from which more could be seen" in words
    assert "R02: REG_DEGENERATE: the smallest eigenvalue is 0.004" in words
    assert "a scan between was taken to find the place of another: tried 1 time, helped 1" in words
    assert "too low" in words
    assert "west" in words and "Table 2" in words


def test_table_1_has_the_figures_of_the_last_cycle(run: FakeRun) -> None:
    first, second = tables.table_1(read_run(run.folder))
    assert (first["N"], second["N"]) == (1, 2)
    assert (second["O"], second["E"], second["O_c"]) == (4300, 41500, 2200)
    assert second["V_s"] == 45800
    assert second["V"] == 48000
    assert second["O/V"] + second["E/V"] + second["O_c/V"] == pytest.approx(1.0)
    assert (second["growing_rate"], second["occluded_decrease_rate"]) == (0.146, 0.14)
    assert second["area_m2"] == pytest.approx(16.0, abs=1e-4)
    points = {event["scan_id"]: event["points"] for event in read_run(run.folder).events_of("scan")}
    assert second["P"] == points["S02"] + points["S03"]


def test_registrations_get_the_verdict_of_their_weakest_figure(run: FakeRun) -> None:
    verdicts = {row["scan"]: row["verdict"] for row in tables.registrations(read_run(run.folder))}
    assert verdicts == {"S01": "reference", "S02": "pass", "S03": "fail"}


@pytest.mark.parametrize("outcome", ["complete", "fault"])
def test_what_went_wrong_at_the_end_stands_at_the_top(outcome: str, tmp_path: Path) -> None:
    run = write_run(tmp_path)
    state = json.loads((run.folder / "state.json").read_text())
    assert tables.outcome(read_run(run.folder))["reason"] == ""
    state |= {"outcome": outcome, "code": "NAV_BLOCKED", "message": "the robot did not come home: a cart"}
    (run.folder / "state.json").write_text(json.dumps(state))
    write_report(run.folder)
    assert "NAV_BLOCKED: the robot did not come home: a cart." in " ".join(Text(page(run)).words.split())
    assert json.loads((run.folder / "report.json").read_text())["summary"]["reason"].startswith("NAV_BLOCKED: ")


def test_every_scan_has_its_residual_and_how_far_the_pose_graph_moved_it(tmp_path: Path) -> None:
    run = write_run(tmp_path)
    assert tables.pose_graph(read_run(run.folder)) is None
    state = json.loads((run.folder / "state.json").read_text())
    for place, scan in enumerate(state["scans"]):
        scan |= {"residual": 0.0014 if place else None, "moved_m": 0.0042 * place}
    (run.folder / "state.json").write_text(json.dumps(state))
    event = {"kind": "poses_optimised", "t": 299.0, "loops": 1, "compared": 5, "disbelieved": [["S01", "S03"]],
             "refused": [], "rms_before": 0.0009, "rms_after": 0.0002, "moved_m": 0.0042, "taken": True,
             "reason": ""}  # fmt: skip
    events = (run.folder / "events.jsonl").read_text().splitlines()[:-1]
    (run.folder / "events.jsonl").write_text("\n".join([*events, json.dumps(event)]) + "\n")
    rows = tables.registrations(read_run(run.folder))
    assert [(row["residual"], row["moved_m"]) for row in rows] == [(None, 0.0), (0.0014, 0.0042), (0.0014, 0.0084)]
    write_report(run.folder)
    words = " ".join(Text(page(run)).words.split())
    assert "1.4" in words and "8.4" in words
    assert "reconsidered together 1 time, by 5 pairs" in words and "doors close 1 loop." in words
    assert "differ by 0.90 mm before the first time and 0.20 mm after the last" in words


@pytest.mark.parametrize(
    ("figure", "value", "expected"),
    [
        ("overlap", 0.30, "pass"), ("overlap", 0.2, "warn"), ("overlap", 0.1, "fail"),
        ("rmse", 0.010, "pass"), ("rmse", 0.011, "warn"), ("rmse", 0.02, "fail"), ("rmse", float("nan"), "fail"),
    ],
)  # fmt: skip
def test_verdicts_turn_at_the_limits(figure: str, value: float, expected: str) -> None:
    assert tables.verdict(figure, value) == expected


def test_times_are_those_of_the_nodes_the_drives_and_the_stages(run: FakeRun) -> None:
    times = timing.times(read_run(run.folder))
    assert times["scanning"] == pytest.approx(3 * 45.0)
    assert times["driving"] == pytest.approx(27.0)
    assert times["thinking"] == pytest.approx(3 * 0.8 + 1.5 + 3.0 + 4.5)
    assert [row["stage"] for row in times["stages"]] == ["next best view", "register"]


def test_a_cycle_lasts_from_the_scan_at_home_to_the_next_goal(tmp_path: Path) -> None:
    """Two scans: after the first a view is driven to, the second is the last and nobody drives."""

    def event(second: float, kind: str, **figures: object) -> dict:
        return {"t": 10 * second, "utc": f"2026-01-02T03:04:{second:06.3f}Z", "kind": kind, **figures}

    drive = {"node": "drive to the view", "path": "/x", "before": "INVALID", "after": "RUNNING"}
    events = [
        event(0.0, "stage", name="warm_up", seconds=9.0),
        event(1.0, "scan", scan_id="S01"),
        event(1.5, "stage", name="validate_scan", seconds=0.25),
        event(3.0, "stage", name="register_scan", seconds=1.25),
        event(3.5, "node", **drive),
        event(5.0, "node", **drive | {"before": "RUNNING", "after": "SUCCESS"}),
        event(6.0, "scan", scan_id="S02"),
        event(6.5, "stage", name="validate_scan", seconds=0.5),
    ]
    (tmp_path / "events.jsonl").write_text("\n".join(map(json.dumps, events)) + "\n")
    run = read_run(tmp_path)
    assert timing.cycles(run) == [
        {"scan": "S01", "thinking": 1.5, "wall": 2.5},
        {"scan": "S02", "thinking": 0.5, "wall": None},
    ]
    (stage,) = [row for row in timing.times(run)["stages"] if row["stage"] == "validate scan"]
    assert (stage["median"], stage["mean"], stage["worst"]) == (0.375, 0.375, 0.5)


def test_every_picture_is_kept_and_not_blank(run: FakeRun) -> None:
    report = json.loads((run.folder / "report.json").read_text())
    names = [Path(name).name for name in report["pictures"]]
    assert names == [
        "plan.png",
        "robot_map.png",
        "cloud_top.png",
        "R01_01_view.png",
        "R01_ceiling.png",
        "R01_flatness.png",
    ]
    for name in report["pictures"]:
        assert cv2.imread(str(run.folder / name)).std() > 5
    assert page(run).count("data:image/png;base64,") == len(names)


def test_the_newest_map_by_number_is_shown(run: FakeRun) -> None:
    # In the map of S10 the obstacle of S02 is gone; by mere spelling S02 would come last.
    image = cv2.imread(str(run.folder / "pictures" / "robot_map.png"))
    height, width = image.shape[:2]
    dark = np.all(image[height // 6 : -height // 6] < 60, axis=2)
    assert dark.sum() < 0.002 * height * width


def test_the_report_in_json_holds_the_same_figures(run: FakeRun) -> None:
    report = json.loads((run.folder / "report.json").read_text())
    assert report["summary"]["outcome"] == "incomplete"
    assert report["summary"]["rooms_complete"] == 1
    assert report["left_out"][0]["what"] == "R02"
    assert report["evaluation"]["rooms_reachable"] == 2
    assert report["failures"][0]["code"] == "REG_DEGENERATE"


def test_a_run_broken_off_at_its_start_still_has_a_report(tmp_path: Path) -> None:
    (tmp_path / "events.jsonl").write_text('{"t": 0, "kind": "mission_started", "site": "x"}\n')
    words = Text(write_report(tmp_path).read_text()).words
    assert "unfinished" in words
    assert "No room was entered" in words


def test_files_cut_short_by_a_crash_do_not_stop_the_report(tmp_path: Path) -> None:
    made = write_run(tmp_path)
    for path in made.folder.glob("evidence/*.npz"):
        path.write_bytes(path.read_bytes()[:100])
    (made.folder / "scans" / "S02.scan").unlink()
    write_report(made.folder)
    names = {Path(name).name for name in json.loads((made.folder / "report.json").read_text())["pictures"]}
    assert names == {"plan.png", "robot_map.png", "cloud_top.png"}
    (made.folder / "scans" / "S03.scan").write_bytes(b"not a scan")
    write_report(made.folder)
    names = {Path(name).name for name in json.loads((made.folder / "report.json").read_text())["pictures"]}
    assert names == {"plan.png", "robot_map.png"}


def test_what_a_run_says_is_never_markup(tmp_path: Path) -> None:
    made = write_run(tmp_path)
    with (made.folder / "events.jsonl").open("a") as file:
        file.write("\n" + json.dumps({"t": 1, "kind": "failure", "code": "X", "message": "<script>alert(1)</script>"}))
    path = made.folder / "events.jsonl"
    path.write_text("\n".join(line for line in path.read_text().splitlines() if line.endswith("}")))
    write_report(made.folder)
    assert "<script>" not in page(made)
    assert "&lt;script&gt;" in page(made)


def test_no_run_no_report(tmp_path: Path) -> None:
    with pytest.raises(FailureError, match="RUN_UNREADABLE"):
        write_report(tmp_path)


def test_figures_are_written_for_people() -> None:
    assert number(1234567) == "1\u202f234\u202f567"
    assert number(None) == number(float("nan")) == "–"
    assert share(0.8042) == "80.4\u202f%"
    assert duration(59.94) == "59.9\u202fs"
    assert duration(119.7) == "2\u202fmin 00\u202fs"
    assert duration(3 * 3600 + 125) == "3\u202fh 02\u202fmin"
