"""This computer's key pair, and the keys of others that it lets in: files that nobody else may read or change.

A folder holds ``secret.key``, from which the public key follows, and ``authorised_keys`` with one line for each
computer that may come in: its public key, its role, its name. Public keys are 64 hexadecimal digits, which survive
shells, YAML and telephones.
"""

import base64
import fcntl
import hashlib
import logging
import os
import re
import stat
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import zmq
from zmq.utils import z85

from drivers.wire.roles import Role
from perception.failure import FailureError

log = logging.getLogger(__name__)

SECRET = "secret.key"
AUTHORISED = "authorised_keys"
MAX_AUTHORISED = 64
_MAX_BYTES = 64 * 1024
_KEY = re.compile(r"[0-9a-f]{64}")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


@dataclass(frozen=True)
class KeyPair:
    """A CURVE key pair: ``public`` in hexadecimal, ``secret`` as its 32 bytes, which are never printed."""

    public: str
    secret: bytes = field(repr=False)


@dataclass(frozen=True)
class Grant:
    """Somebody who is let in."""

    key: str
    role: Role
    name: str


def default_folder() -> Path:
    """Where the keys are when no folder is named."""
    config = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(config) / "building-scan-mission" / "keys"


def is_public_key(text: str) -> bool:
    """Whether the text has the form of a public key."""
    return _KEY.fullmatch(text) is not None


def fingerprint(public: str) -> str:
    """Five groups of four letters, 100 bits, for two people to compare by voice."""
    letters = base64.b32encode(hashlib.sha256(bytes.fromhex(public)).digest()).decode()
    return "-".join(letters[start : start + 4] for start in range(0, 20, 4))


class Keyring:
    """The keys in one folder, which is made at the first need.

    Raises, from whatever touches the files:
        FailureError: ``KEYS_EXPOSED`` when others could read or change them, ``KEYS_UNREADABLE``.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._read: tuple[object, tuple[Grant, ...]] = (None, ())

    @cached_property
    def own(self) -> KeyPair:
        """This computer's key pair, made when there is none."""
        with self._opened() as folder:
            if not _exists(folder, SECRET):
                _, secret = zmq.curve_keypair()
                self._create(folder, SECRET, z85.decode(secret).hex())
            text = self._content(folder, SECRET).strip()
        if not is_public_key(text):  # a secret key has the form of a public one
            raise self._unreadable(SECRET, "it holds no key; remove it to have a new one made")
        secret = z85.encode(bytes.fromhex(text))
        return KeyPair(z85.decode(zmq.curve_public(secret)).hex(), bytes.fromhex(text))

    def grants(self) -> tuple[Grant, ...]:
        """Who is let in, as the file says now; it is only read again when it changed."""
        try:
            found = (self.folder / AUTHORISED).lstat()
        except FileNotFoundError:
            return ()
        except OSError as error:
            raise self._unreadable(AUTHORISED, str(error.strerror)) from error
        signature = (found.st_ino, found.st_mtime_ns, found.st_ctime_ns, found.st_size)
        if signature != self._read[0]:
            with self._opened() as folder:
                self._read = (signature, self._parsed(self._content(folder, AUTHORISED)))
        return self._read[1]

    def role_of(self, key: str) -> Role | None:
        """The role of a key; None for a stranger, and for everybody while the file cannot be trusted."""
        try:
            return next((grant.role for grant in self.grants() if grant.key == key), None)
        except FailureError as error:
            log.error("nobody is let in: %s", error)
            return None

    def authorise(self, key: str, role: Role, name: str) -> Grant:
        """Let a key in under a name; a key that was in already has its role and its name changed.

        Raises:
            FailureError: ``KEY_INVALID``, ``NAME_INVALID``, ``NAME_TAKEN`` by another key, ``TOO_MANY_KEYS``; and as
                the class says.
        """
        key = key.strip().lower()
        if not is_public_key(key):
            raise FailureError("KEY_INVALID", "a public key is 64 hexadecimal digits, as `mission keys` prints it")
        if not _NAME.fullmatch(name):
            raise FailureError("NAME_INVALID", f"'{name}': a name is up to 64 letters, digits, dots, dashes")
        grant = Grant(key, role, name)
        with self._opened() as folder, _locked(folder):
            others = [known for known in self.grants() if known.key != key]
            if any(known.name == name for known in others):
                raise FailureError("NAME_TAKEN", f"another key is paired as {name}; first: mission unpair {name}")
            if len(others) >= MAX_AUTHORISED:
                raise FailureError("TOO_MANY_KEYS", f"{MAX_AUTHORISED} keys are paired; unpair one first")
            self._store(folder, [*others, grant])
        return grant

    def revoke(self, name: str) -> Grant:
        """Let a name in no more; what it asks is refused from its next message on. Raises ``NAME_UNKNOWN``."""
        with self._opened() as folder, _locked(folder):
            grants = self.grants()
            gone = next((grant for grant in grants if grant.name == name), None)
            if gone is None:
                known = ", ".join(grant.name for grant in grants) or "nobody"
                raise FailureError("NAME_UNKNOWN", f"nobody is paired as {name}; paired: {known}")
            self._store(folder, [grant for grant in grants if grant != gone])
        return gone

    @contextmanager
    def _opened(self) -> Iterator[int]:
        """The folder as a handle, so that no file in it can be swapped by way of its path."""
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            handle = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            raise FailureError("KEYS_UNREADABLE", f"{self.folder}: {error.strerror}") from error
        try:
            _require_private(os.fstat(handle), self.folder, "700")
            yield handle
        except OSError as error:
            raise FailureError("KEYS_UNREADABLE", f"{self.folder}: {error.strerror}") from error
        finally:
            os.close(handle)

    def _content(self, folder: int, name: str) -> str:
        handle = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder)
        with os.fdopen(handle, "rb") as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode):
                raise self._unreadable(name, "it is not a file")
            _require_private(found, self.folder / name, "600")
            content = file.read(_MAX_BYTES + 1)
        try:
            if len(content) > _MAX_BYTES:
                raise ValueError
            return content.decode("ascii")
        except ValueError as error:
            raise self._unreadable(name, "it is not one of ours") from error

    def _parsed(self, text: str) -> tuple[Grant, ...]:
        grants: list[Grant] = []
        for number, line in enumerate(text.splitlines(), 1):
            if not line.strip() or line.startswith("#"):
                continue
            parts = line.split()
            if not (len(parts) == 3 and is_public_key(parts[0]) and parts[1] in {*Role} and _NAME.fullmatch(parts[2])):
                raise self._unreadable(AUTHORISED, f"line {number}: expected KEY ROLE NAME, found '{line[:100]}'")
            grants.append(Grant(parts[0], Role(parts[1]), parts[2]))
        if any(len({getattr(grant, what) for grant in grants}) < len(grants) for what in ("key", "name")):
            raise self._unreadable(AUTHORISED, "a key or a name stands there twice")
        return tuple(grants)

    def _store(self, folder: int, grants: list[Grant]) -> None:
        text = "".join(f"{grant.key} {grant.role} {grant.name}\n" for grant in grants)
        os.replace(_written(folder, text), AUTHORISED, src_dir_fd=folder, dst_dir_fd=folder)
        os.fsync(folder)

    def _create(self, folder: int, name: str, text: str) -> None:
        """A file that appears whole, or not when another process was quicker."""
        temporary = _written(folder, text + "\n")
        try:
            with suppress(FileExistsError):
                os.link(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
        finally:
            os.unlink(temporary, dir_fd=folder)
        os.fsync(folder)

    def _unreadable(self, name: str, why: str) -> FailureError:
        return FailureError("KEYS_UNREADABLE", f"{self.folder / name}: {why}", file=str(self.folder / name))


def _require_private(found: os.stat_result, path: Path, mode: str) -> None:
    if found.st_uid != os.geteuid() or found.st_mode & 0o077:
        raise FailureError(
            "KEYS_EXPOSED",
            f"{path} can be read or changed by others (mode {stat.S_IMODE(found.st_mode):03o}, owner {found.st_uid}); "
            f"if nobody did: chmod {mode} {path}; if somebody may have: `mission unpair` it wherever it is "
            "paired, remove it, and pair the new one",
            file=str(path),
        )


def _written(folder: int, text: str) -> str:
    name = f".{uuid.uuid4().hex}"
    handle = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600, dir_fd=folder)
    with os.fdopen(handle, "w", encoding="ascii") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    return name


def _exists(folder: int, name: str) -> bool:
    try:
        os.stat(name, dir_fd=folder, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return True


@contextmanager
def _locked(folder: int) -> Iterator[None]:
    fcntl.flock(folder, fcntl.LOCK_EX)  # ends with the handle
    yield
