"""A site's configuration: every error at once, with its dotted key."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from mission.config import ConfigError, dump_config, load_config, parse_config

WHOLE: dict[str, Any] = {
    "site": "school",
    "scanner": {"control": "tcp://127.0.0.1:5551", "bulk": "tcp://127.0.0.1:5552"},
    "base": {"control": "tcp://127.0.0.1:5561", "telemetry": "tcp://127.0.0.1:5562"},
}


def refusal(data: object, overrides: tuple[str, ...] = ()) -> list[str]:
    with pytest.raises(ConfigError) as refused:
        parse_config(data, "site.yaml", overrides)
    return str(refused.value).splitlines()


def test_what_is_not_said_is_the_default() -> None:
    config = parse_config(dict(WHOLE), "site.yaml")
    assert config.clock_rate == 1.0
    assert config.settings.room.growing_rate == 0.04
    assert config.settings.room.occluded_decrease_rate == 0.05


def test_a_setting_deep_down_leaves_its_neighbours_alone() -> None:
    config = parse_config({**WHOLE, "settings": {"room": {"max_scans": 3}}}, "site.yaml")
    assert (config.settings.room.max_scans, config.settings.room.voxel_m) == (3, 0.10)


def test_every_error_is_told_at_once_with_its_key() -> None:
    broken = {
        **WHOLE,
        "site": "Not A Name",
        "clock_rate": 0,
        "settings": {"room": {"labeller": "magic", "max_scans": "many"}},
    }
    lines = refusal(broken)
    for key in ("site", "clock_rate", "settings.room.labeller", "settings.room.max_scans"):
        assert sum(line.startswith(f"site.yaml: {key}: ") for line in lines) == 1, key
    assert len(lines) == 4
    assert any("found 'magic'" in line for line in lines)


def test_a_missing_key_is_named() -> None:
    assert any(line.startswith("site.yaml: site: ") for line in refusal({"scanner": {}, "base": {}}))


@pytest.mark.parametrize(
    ("extra", "key", "meant"),
    [
        ({"scaner": {}}, "scaner", "scanner"),
        ({"settings": {"scaning": {}}}, "settings.scaning", "scanning"),
        ({"settings": {"room": {"growing_rat": 0.1}}}, "settings.room.growing_rat", "growing_rate"),
    ],
)
def test_an_unknown_key_is_refused_with_what_was_meant(extra: dict[str, Any], key: str, meant: str) -> None:
    assert refusal({**WHOLE, **extra}) == [f"site.yaml: {key}: unknown key; did you mean '{meant}'?"]


def test_an_unknown_key_like_nothing_else_is_refused_with_what_is_known() -> None:
    (line,) = refusal({**WHOLE, "xyzzy": 1})
    assert "known here: version, site, scanner, base, clock_rate, keys, settings" in line


def test_unknown_keys_and_broken_values_are_told_together() -> None:
    lines = refusal({**WHOLE, "clock_rate": -1, "settings": {"room": {"growing_rat": 0.1}}})
    assert len(lines) == 2


def test_overrides_come_on_top_and_are_yaml() -> None:
    config = parse_config(
        {**WHOLE, "settings": {"scanning": {"step_deg": 0.5}}},
        "site.yaml",
        ("settings.scanning.step_deg=0.1", "settings.building.return_to_start=false"),
    )
    assert config.settings.scanning.step_deg == 0.1
    assert config.settings.building.return_to_start is False


@pytest.mark.parametrize("limit", ["memory_high_gb", "memory_cap_gb"])
@pytest.mark.parametrize("value", ["0", "-1"])
def test_a_worker_must_be_allowed_some_memory(limit: str, value: str) -> None:
    (line,) = refusal(dict(WHOLE), (f"settings.worker.{limit}={value}",))
    assert line == f"site.yaml: settings.worker.{limit}: expected more than 0, found {value}"


def test_a_worker_is_not_killed_before_it_is_replaced() -> None:
    (line,) = refusal(dict(WHOLE), ("settings.worker.memory_high_gb=13",))
    assert line.startswith("site.yaml: settings.worker") and "must not be less than memory_high_gb" in line


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("clock_rate", "fast", "expected a number, found 'fast'"),
        ("clock_rate", ".inf", "expected at most 1000, found inf"),
        ("settings.scanning.step_deg", "-1", "expected at least 0.01, found -1"),
        ("settings.scanning.attempts", "1.5", "expected a whole number, found 1.5"),
        ("settings.battery.low", "2", "expected at most 1, found 2"),
        ("settings.operator.ask", "maybe", "expected true or false, found 'maybe'"),
        ("settings.room.labeller", "magic", "expected 'range' or 'paper', found 'magic'"),
        ("settings.driving", "3", "expected a group of keys, found 3"),
        ("base", "3", "expected a group of keys, found 3"),
        ("base", "{}", "control: expected a value, found nothing"),
        ("site", "3", "expected text, found 3"),
        ("settings.building.fence", "[1, 2]", "expected a list, found 1"),
    ],
)
def test_an_error_says_what_was_expected_and_what_was_found(key: str, value: str, expected: str) -> None:
    assert any(
        line.startswith(f"site.yaml: {key}") and line.endswith(expected)
        for line in refusal(dict(WHOLE), (f"{key}={value}",))
    )


@pytest.mark.parametrize("override", ["settings.room.max_scans", "site.name=x"])
def test_an_override_that_cannot_be_applied_says_which(override: str) -> None:
    assert override in refusal(dict(WHOLE), (override,))[0]


@pytest.mark.parametrize("data", [None, [], "text", 3])
def test_what_is_no_mapping_is_no_configuration(data: object) -> None:
    assert "expected keys and values" in refusal(data)[0]


def test_a_resolved_configuration_is_read_back_as_it_was(tmp_path: Path) -> None:
    config = parse_config({**WHOLE, "clock_rate": 20, "settings": {"room": {"labeller": "paper"}}}, "site.yaml")
    path = tmp_path / "config.yaml"
    path.write_text(dump_config(config))
    assert load_config(path) == config


@settings(max_examples=25)
@given(
    st.floats(0.001, 1000),
    st.integers(1, 50),
    st.sampled_from(["range", "paper"]),
    st.from_regex(r"\A[a-z0-9_-]{1,9}\Z"),
)
def test_any_configuration_survives_the_way_to_its_file(rate: float, scans: int, labeller: str, name: str) -> None:
    data = {**WHOLE, "site": f"s{name}", "clock_rate": rate}
    config = parse_config({**data, "settings": {"room": {"max_scans": scans, "labeller": labeller}}}, "site.yaml")
    assert parse_config(yaml.safe_load(dump_config(config)), "config.yaml") == config


@pytest.mark.parametrize(
    ("text", "complaint"),
    [("site: [unclosed", "not YAML"), ("\x00", "not YAML"), ("- a\n- b\n", "expected keys"), ("", "found NoneType")],
)
def test_a_file_that_is_no_configuration_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "site.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=complaint):
        load_config(path)


def test_a_file_that_is_absent_or_far_too_large_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        load_config(tmp_path / "absent.yaml")
    large = tmp_path / "large.yaml"
    large.write_text("#" * (256 * 1024 + 1))
    with pytest.raises(ConfigError, match="at most 262144 bytes"):
        load_config(large)


def test_a_yaml_file_makes_no_objects(tmp_path: Path) -> None:
    path = tmp_path / "site.yaml"
    path.write_text("site: !!python/object/apply:os.getcwd []\n")
    with pytest.raises(ConfigError, match="not YAML"):
        load_config(path)


def test_a_fence_is_read_kept_and_refused_with_the_reason(tmp_path: Path) -> None:
    def fenced(corners: list[list[float]]) -> dict[str, Any]:
        return WHOLE | {"settings": {"building": {"fence": corners}}}

    config = parse_config(fenced([[-2, -3], [12, -3], [12, 9], [-2, 9]]), "site.yaml")
    assert config.settings.building.fence == ((-2.0, -3.0), (12.0, -3.0), (12.0, 9.0), (-2.0, 9.0))
    kept = tmp_path / "config.yaml"
    kept.write_text(dump_config(config))
    assert load_config(kept) == config
    (line,) = refusal(fenced([[1, 1], [2, 1], [2, 2]]))
    assert line.startswith("site.yaml: settings.building") and "must lie inside the fence" in line


@pytest.mark.parametrize(
    "setting",
    ["operator.patience_s=.inf", "scanning.timeout_s=.inf", "building.base_lost_s=.nan", "scanning.min_free_gb=0"],
)
def test_a_limit_that_would_never_be_met_is_refused(setting: str) -> None:
    key = setting.partition("=")[0]
    (line,) = refusal(dict(WHOLE), (f"settings.{setting}",))
    assert f"settings.{key}: expected " in line


@pytest.mark.parametrize(("agent", "address"), [("scanner", "bulk"), ("base", "telemetry")])
def test_an_address_that_is_missing_is_named(agent: str, address: str) -> None:
    data = {**WHOLE, agent: {"control": WHOLE[agent]["control"]}}
    (line,) = refusal(data)
    assert f"{agent}.{address}: expected an address" in line
