"""Who may command whom: this computer's key, the keys it lets in, and what a mission shows to its agents."""

from pathlib import Path
from typing import Any

from drivers.wire.endpoints import Endpoints
from drivers.wire.keys import Grant, Keyring, default_folder, fingerprint
from drivers.wire.roles import Role
from drivers.wire.sockets import Sockets
from mission.config import SiteConfig
from perception.failure import FailureError


def keyring_in(folder: Path | None) -> Keyring:
    """The keys in a folder, by default in the user's own."""
    return Keyring((folder or default_folder()).expanduser())


def sockets_to(config: SiteConfig, agent: Endpoints) -> Sockets:
    """The sockets for the clients of one agent of a site: with this computer's key when the agent has one."""
    return Sockets(keyring_in(config.keys), agent.server_key) if agent.server_key else Sockets()


def describe(keyring: Keyring) -> dict[str, Any]:
    """What `mission keys` shows: JSON-ready, and without the secret."""
    own = keyring.own
    paired = [
        {"name": grant.name, "role": grant.role, "key": grant.key, "fingerprint": fingerprint(grant.key)}
        for grant in keyring.grants()
    ]
    return {"folder": str(keyring.folder), "key": own.public, "fingerprint": fingerprint(own.public), "paired": paired}


def as_text(found: dict[str, Any]) -> str:
    """The same for people."""
    lines = [f"folder       {found['folder']}", f"public key   {found['key']}", f"fingerprint  {found['fingerprint']}"]
    lines += [f"may come in  {who['fingerprint']}  {who['role']:<9}  {who['name']}" for who in found["paired"]]
    return "\n".join(lines if found["paired"] else [*lines, "may come in  nobody; let somebody in: mission pair"])


def pair(keyring: Keyring, key: str, role: str, name: str) -> str:
    """Let a key in; the lines to show to whoever did so. Raises ``ROLE_INVALID``, or as :meth:`Keyring.authorise`."""
    if role not in {*Role}:
        raise FailureError("ROLE_INVALID", f"'{role}': expected {', '.join(Role)}")
    grant = keyring.authorise(key, Role(role), name)
    return _said(grant, "may come in as", "compare it with the one that `mission keys` shows there")


def unpair(keyring: Keyring, name: str) -> str:
    """Let a name in no more; the line to show. Raises as :meth:`Keyring.revoke`."""
    return _said(keyring.revoke(name), "may no more come in as", "whatever it asks is refused from now on")


def _said(grant: Grant, verb: str, then: str) -> str:
    return f"{grant.name} {verb} {grant.role}\nfingerprint  {fingerprint(grant.key)}; {then}"
