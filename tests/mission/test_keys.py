"""The commands about keys, and a mission that meets agents with keys: what is shown, said, and refused."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.agent import base_agent, scanner_agent
from drivers.wire.base_client import BaseClient
from drivers.wire.keys import Keyring
from drivers.wire.roles import Role
from mission.cli import app
from mission.commands.common import USAGE
from mission.config import ConfigError, dump_config, load_config, parse_config
from mission.doctor import examine
from mission.keys import sockets_to
from tests.drivers.wire_fakes import ANYWHERE, QUICK, FakeBase, FakeScanner, value_of

KEY = "ab" * 32
LOCAL = {"control": "tcp://127.0.0.1:5601", "bulk": "tcp://127.0.0.1:5602", "telemetry": "tcp://127.0.0.1:5612"}
REMOTE = {"control": "tcp://192.0.2.7:5601", "bulk": "tcp://192.0.2.7:5602"}


def invoke(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_two_computers_are_paired_by_what_the_commands_print(tmp_path: Path) -> None:
    robot, office = tmp_path / "robot", tmp_path / "office"
    shown = json.loads(invoke("keys", "--keys", office, "--json").stdout)
    said = invoke("pair", shown["key"], "--role", "executive", "--name", "office", "--keys", robot).stdout
    assert shown["fingerprint"] in said and shown["fingerprint"] in invoke("keys", "--keys", office).stdout
    paired = json.loads(invoke("keys", "--keys", robot, "--json").stdout)["paired"]
    assert [(who["name"], who["role"], who["key"]) for who in paired] == [("office", "executive", shown["key"])]
    assert "office" in invoke("keys", "--keys", robot).stdout
    assert invoke("unpair", "office", "--keys", robot).exit_code == 0
    assert "nobody" in invoke("keys", "--keys", robot).stdout


def test_the_secret_is_never_printed(tmp_path: Path) -> None:
    outputs = [invoke("keys", "--keys", tmp_path / "k"), invoke("keys", "--keys", tmp_path / "k", "--json")]
    secret = (tmp_path / "k" / "secret.key").read_text().strip()
    assert all(output.exit_code == 0 and secret not in output.output for output in outputs)


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("pair", "ab", "--role", "observer", "--name", "x"), "KEY_INVALID"),
        (("pair", KEY, "--role", "boss", "--name", "x"), "ROLE_INVALID"),
        (("pair", KEY, "--role", "observer", "--name", "../x"), "NAME_INVALID"),
        (("unpair", "x"), "NAME_UNKNOWN"),
    ],
)
def test_what_cannot_be_paired_is_refused_in_one_line(arguments: tuple[str, ...], code: str, tmp_path: Path) -> None:
    result = invoke(*arguments, "--keys", tmp_path / "k")
    assert result.exit_code == USAGE and code in result.output and "Traceback" not in result.output


def test_the_keys_are_the_users_own_when_no_folder_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert invoke("keys").exit_code == 0
    assert (tmp_path / "building-scan-mission" / "keys" / "secret.key").exists()


def test_an_agent_elsewhere_without_its_key_is_refused_with_what_to_do() -> None:
    with pytest.raises(ConfigError, match=r"scanner: .*192.0.2.7.*server_key is needed"):
        parse_config({"site": "a", "scanner": REMOTE, "base": LOCAL}, "site.yaml")
    with pytest.raises(ConfigError, match=r"base: .*64 hexadecimal"):
        parse_config({"site": "a", "scanner": LOCAL, "base": {**LOCAL, "server_key": "short"}}, "site.yaml")


def test_keys_survive_in_the_run_folder(tmp_path: Path) -> None:
    data = {"site": "a", "keys": "~/k", "scanner": {**REMOTE, "server_key": KEY}, "base": LOCAL}
    config = parse_config(data, "site.yaml")
    assert config.keys == Path.home() / "k" and config.scanner.server_key == KEY
    path = tmp_path / "config.yaml"
    path.write_text(dump_config(config))
    assert load_config(path) == config


def test_a_configuration_that_would_fill_the_memory_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "site.yaml"
    bomb = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"{after}: &{after} [{','.join([f'*{before}'] * 9)}]\n"
        for before, after in zip("abcdefgh", "bcdefghi", strict=True)
    )
    for text in (bomb, bomb + "site: *i\n", "[" * 5_000):
        path.write_text(text)
        with pytest.raises(ConfigError) as refused:
            load_config(path)
        assert len(str(refused.value)) < 10_000


def test_a_mission_meets_agents_with_keys(tmp_path: Path) -> None:
    robot, office = Keyring(tmp_path / "robot"), Keyring(tmp_path / "office")
    robot.authorise(office.own.public, Role.EXECUTIVE, "office")
    with (
        base_agent(FakeBase(), ANYWHERE, robot) as base,
        scanner_agent(FakeScanner(), ANYWHERE, tmp_path / "spool", robot) as scanner,
    ):
        data = {
            "site": "a",
            "keys": str(office.folder),
            "scanner": {
                "control": scanner.endpoints.control,
                "bulk": scanner.endpoints.bulk,
                "server_key": robot.own.public,
            },
            "base": {
                "control": base.endpoints.control,
                "telemetry": base.endpoints.telemetry,
                "server_key": robot.own.public,
            },
        }
        config = parse_config(data, "site.yaml")
        client = BaseClient(config.base, QUICK, sockets_to(config, config.base))
        assert value_of(client.info()).model == "fake base"
        client.close()
        path = tmp_path / "site.yaml"
        path.write_text(dump_config(config))
        found = {finding.what: finding for finding in examine(path)}
        assert found["scanner"].good and found["base"].good, found
        office.folder.chmod(0o755)
        assert "KEYS_EXPOSED" in " ".join(finding.found for finding in examine(path) if not finding.good)
