"""A site's configuration: YAML, checked whole, every error at once with its dotted key."""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from behaviours.settings import Settings
from drivers.refusal import key_of, told
from drivers.wire.endpoints import Endpoints, is_local
from drivers.wire.keys import is_public_key

_MAX_BYTES = 256 * 1024


class ConfigError(Exception):
    """A configuration that cannot be used; the message lists every reason, one a line."""


class SiteConfig(BaseModel):
    """One site: its name, the two agents, and the mission's settings.

    ``clock_rate`` is mission seconds for one second of the wall; other than 1 only in a rehearsal. ``keys`` is the
    folder of this computer's keys, by default the user's own; an agent with a ``server_key`` must prove to hold that
    key, and one on another machine must have it.
    """

    model_config = ConfigDict(extra="forbid")

    version: Literal[1] = 1
    site: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$")]
    scanner: Endpoints
    base: Endpoints
    clock_rate: Annotated[float, Field(gt=0, le=1000)] = 1.0
    keys: Path | None = None
    settings: Settings = Field(default_factory=Settings)

    @field_validator("scanner", "base")
    @classmethod
    def _proves_who_it_is(cls, agent: Endpoints) -> Endpoints:
        if agent.server_key and not is_public_key(agent.server_key):
            raise ValueError(
                "server_key is the 64 hexadecimal digits that `mission keys` prints on the agent's computer"
            )
        remote = [address for address in agent.addresses if not is_local(address)]
        if remote and not agent.server_key:
            raise ValueError(f"{remote[0]} is on another machine, so server_key is needed: docs/security.md")
        return agent

    @model_validator(mode="after")
    def _is_whole(self) -> "SiteConfig":
        for key, address, what in (
            ("scanner.bulk", self.scanner.bulk, "scans come home by it"),
            ("base.telemetry", self.base.telemetry, "the base says by it where it is"),
        ):
            if not address:
                raise ValueError(f"{key}: expected an address, for {what}; found nothing")
        return self

    @field_validator("keys")
    @classmethod
    def _from_anywhere(cls, folder: Path | None) -> Path | None:
        # The configuration is kept in the run folder, and may be read again from another place.
        return None if folder is None else folder.expanduser().absolute()


def load_config(path: Path, overrides: Iterable[str] = ()) -> SiteConfig:
    """Read a site's YAML; ``overrides`` are ``a.b=value`` on top of it.

    Raises:
        ConfigError: if the file is missing, too large, not YAML, or breaks any rule; all reasons at once.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ConfigError(f"{path}: expected at most {_MAX_BYTES} bytes, found {path.stat().st_size}")
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"{path}: not YAML: {error}") from error
    return parse_config(data, str(path), overrides)


def parse_config(data: object, source: str, overrides: Iterable[str] = ()) -> SiteConfig:
    """Check plain data as a configuration; see :func:`load_config`."""
    if not isinstance(data, dict):
        raise ConfigError(f"{source}: expected keys and values, found {type(data).__name__}")
    for override in overrides:
        _apply(data, override)
    unknown = list(_unknown_keys(data, SiteConfig))
    try:
        config = SiteConfig.model_validate(data)
    except ValidationError as error:
        known_unknown = {key for key, _ in unknown}
        lines = [told(item) for item in error.errors() if key_of(item) not in known_unknown]
        raise ConfigError("\n".join(f"{source}: {line}" for line in [*lines, *_hints(unknown)])) from error
    if unknown:
        raise ConfigError("\n".join(f"{source}: {line}" for line in _hints(unknown)))
    return config


def dump_config(config: SiteConfig) -> str:
    """The resolved configuration as YAML that :func:`load_config` reads back."""
    return yaml.safe_dump(config.model_dump(mode="json", exclude_none=True), sort_keys=False)


def _apply(data: dict[str, Any], override: str) -> None:
    key, separator, value = override.partition("=")
    if not separator:
        raise ConfigError(f"--set {override}: expected key=value")
    *path, last = key.split(".")
    for name in path:
        data = data.setdefault(name, {})
        if not isinstance(data, dict):
            raise ConfigError(f"--set {override}: {name} is a value, not a group of keys")
    try:
        data[last] = yaml.safe_load(value)
    except yaml.YAMLError as error:
        raise ConfigError(f"--set {override}: the value is not YAML") from error


def _unknown_keys(data: Mapping[str, Any], model: type, above: str = "") -> Iterable[tuple[str, list[str]]]:
    """Keys that no field has, with the names that were meant to stand there."""
    types = _fields(model)
    for key, value in data.items():
        if key not in types:
            yield f"{above}{key}", list(types)
        elif isinstance(value, dict) and _fields(types[key]):
            yield from _unknown_keys(value, types[key], f"{above}{key}.")


def _fields(model: Any) -> dict[str, Any]:
    if isinstance(model, type) and issubclass(model, BaseModel):
        return {name: info.annotation for name, info in model.model_fields.items()}
    if is_dataclass(model) and isinstance(model, type):
        hints = get_type_hints(model)
        return {field.name: hints[field.name] for field in fields(model)}
    return {}


def _hints(unknown: Iterable[tuple[str, list[str]]]) -> list[str]:
    lines = []
    for key, known in unknown:
        near = difflib.get_close_matches(key.rpartition(".")[2], known, n=1)
        meant = f"did you mean '{near[0]}'?" if near else f"known here: {', '.join(known)}"
        lines.append(f"{key}: unknown key; {meant}")
    return lines
