"""Keys on disk: made once, readable by their owner alone, refused when they are not; and who is let in by them."""

import os
import re
import threading

import pytest
import zmq
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from zmq.utils import z85

from drivers.wire.keys import AUTHORISED, MAX_AUTHORISED, SECRET, Keyring, fingerprint, is_public_key
from drivers.wire.rates import Rates
from drivers.wire.roles import Role
from perception.failure import FailureError

KEY, OTHER = "ab" * 32, "cd" * 32


@pytest.fixture
def keyring(tmp_path):
    before = os.umask(0o022)
    keyring = Keyring(tmp_path / "some" / "keys")
    assert keyring.own
    yield keyring
    os.umask(before)


def code_of(action, *arguments) -> str:
    with pytest.raises(FailureError) as error:
        action(*arguments)
    return error.value.failure.code


def names(folder) -> list[str]:
    return [path.name for path in folder.iterdir()]


def mode(path) -> int:
    return path.stat().st_mode & 0o777


def test_the_first_need_makes_a_key_that_only_its_owner_can_read(keyring):
    assert mode(keyring.folder) == 0o700 and mode(keyring.folder / SECRET) == 0o600
    assert names(keyring.folder) == [SECRET]
    own = keyring.own
    public = zmq.curve_public(z85.encode(own.secret))
    assert own.public == z85.decode(public).hex()
    assert Keyring(keyring.folder).own == own


def test_the_secret_is_not_shown(keyring):
    assert keyring.own.secret.hex() not in repr(keyring.own) + repr(vars(keyring))


def test_two_processes_that_come_first_at_once_have_one_key(tmp_path):
    rings = [Keyring(tmp_path / "keys") for _ in range(8)]
    threads = [threading.Thread(target=lambda ring=ring: ring.own) for ring in rings]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({ring.own.public for ring in rings}) == 1
    assert names(tmp_path / "keys") == [SECRET]


@pytest.mark.parametrize("bits", [0o640, 0o604, 0o620, 0o602, 0o666])
@pytest.mark.parametrize("name", [SECRET, AUTHORISED])
def test_files_that_others_can_read_or_change_are_not_used(keyring, name, bits):
    keyring.authorise(KEY, Role.OBSERVER, "anna")
    (keyring.folder / name).chmod(bits)
    fresh = Keyring(keyring.folder)
    assert code_of(lambda: fresh.own if name == SECRET else fresh.grants()) == "KEYS_EXPOSED"
    assert fresh.role_of(KEY) is (Role.OBSERVER if name == SECRET else None)


def test_a_folder_that_others_can_enter_is_not_used(keyring):
    keyring.folder.chmod(0o755)
    assert code_of(lambda: Keyring(keyring.folder).own) == "KEYS_EXPOSED"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
def test_a_secret_of_somebody_else_is_not_used(keyring):
    os.chown(keyring.folder / SECRET, 12345, -1)
    assert code_of(lambda: Keyring(keyring.folder).own) == "KEYS_EXPOSED"


@pytest.mark.parametrize("name", [SECRET, AUTHORISED])
def test_links_pipes_and_folders_in_place_of_a_file_are_not_followed(keyring, name, tmp_path):
    path, elsewhere = keyring.folder / name, tmp_path / "elsewhere"
    elsewhere.write_text(f"{KEY} executive eve\n" if name == AUTHORISED else KEY)
    elsewhere.chmod(0o600)
    for make in (lambda: path.symlink_to(elsewhere), lambda: os.mkfifo(path, 0o600), lambda: path.mkdir(0o700)):
        path.unlink(missing_ok=True)
        make()
        fresh = Keyring(keyring.folder)
        assert code_of(lambda ring=fresh: ring.own if name == SECRET else ring.grants()) == "KEYS_UNREADABLE"
        assert fresh.role_of(KEY) is None


@pytest.mark.parametrize("content", [b"", b"short", b"zz" * 32, b"\xff" * 64, b"ab" * 33, b"0" * 200_000])
def test_a_secret_that_is_none_is_named(keyring, content):
    (keyring.folder / SECRET).write_bytes(content)
    assert code_of(lambda: Keyring(keyring.folder).own) == "KEYS_UNREADABLE"


def test_who_was_paired_is_let_in_with_a_role_until_unpaired(keyring):
    assert keyring.role_of(KEY) is None
    keyring.authorise(KEY, Role.OBSERVER, "anna")
    reader = Keyring(keyring.folder)
    assert reader.role_of(KEY) is Role.OBSERVER and reader.role_of(OTHER) is None
    keyring.authorise(KEY.upper() + "\n", Role.EXECUTIVE, "robot-pc")
    assert [(grant.role, grant.name) for grant in reader.grants()] == [(Role.EXECUTIVE, "robot-pc")]
    assert mode(keyring.folder / AUTHORISED) == 0o600
    assert keyring.revoke("robot-pc").key == KEY
    assert reader.role_of(KEY) is None


def test_names_and_keys_are_not_mixed_up(keyring):
    keyring.authorise(KEY, Role.OBSERVER, "anna")
    assert code_of(keyring.authorise, OTHER, Role.OBSERVER, "anna") == "NAME_TAKEN"
    assert code_of(keyring.revoke, "bob") == "NAME_UNKNOWN"
    for key in ("", "ab", KEY + "0", "g" * 64, KEY + " executive eve"):
        assert code_of(keyring.authorise, key, Role.OBSERVER, "eve") == "KEY_INVALID"
    for name in ("", "../x", "a b", "a\nb", "-a", "x" * 65, "ä"):
        assert code_of(keyring.authorise, OTHER, Role.OBSERVER, name) == "NAME_INVALID"
    keyring.authorise(OTHER, Role.OBSERVER, "x" * 64)


def test_only_so_many_can_be_paired(keyring):
    lines = (f"{number:064x} observer n{number}\n" for number in range(MAX_AUTHORISED - 1))
    (keyring.folder / AUTHORISED).touch(0o600)
    (keyring.folder / AUTHORISED).write_text("".join(lines))
    keyring.authorise(KEY, Role.OBSERVER, "last")
    keyring.authorise(KEY, Role.EXECUTIVE, "last")
    assert code_of(keyring.authorise, OTHER, Role.OBSERVER, "one-more") == "TOO_MANY_KEYS"


line = st.one_of(
    st.text(max_size=80),
    st.builds(
        "{} {} {}".format,
        st.sampled_from([KEY, OTHER, KEY[:-1], "*"]),
        st.sampled_from(["observer", "executive", "root", "*", "Executive"]),
        st.sampled_from(["anna", "bob", "", "*", "a b"]),
    ),
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lines=st.lists(line, max_size=4))
def test_a_list_is_read_whole_or_lets_nobody_in(keyring, lines):
    text = "\n".join(lines)
    (keyring.folder / AUTHORISED).touch(0o600)
    (keyring.folder / AUTHORISED).write_bytes(text.encode("utf-8", "surrogatepass"))
    fresh = Keyring(keyring.folder)
    try:
        grants = fresh.grants()
    except FailureError as error:
        assert error.failure.code == "KEYS_UNREADABLE"
        assert fresh.role_of(KEY) is None and fresh.role_of(OTHER) is None
        return
    for grant in grants:
        assert f"{grant.key} {grant.role} {grant.name}" in " ".join(text.split())
        assert is_public_key(grant.key)
    assert len({grant.key for grant in grants}) == len(grants)


def test_two_pairings_at_once_are_both_kept(keyring):
    rings = [Keyring(keyring.folder) for _ in range(8)]
    threads = [
        threading.Thread(target=ring.authorise, args=(f"{number:064x}", Role.OBSERVER, f"n{number}"))
        for number, ring in enumerate(rings)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(keyring.grants()) == 8


def test_a_fingerprint_tells_keys_apart_and_can_be_read_aloud():
    prints = [fingerprint(f"{number:064x}") for number in range(1000)]
    assert len(set(prints)) == 1000
    assert all(re.fullmatch("[A-Z2-7]{4}(-[A-Z2-7]{4}){4}", print_) for print_ in prints)
    assert fingerprint(KEY) == fingerprint(KEY)


def test_a_client_has_its_rate_and_not_more():
    now = [0.0]
    rates = Rates(10.0, clock=lambda: now[0])
    assert sum(rates.admits("a") for _ in range(100)) == 10
    assert rates.admits("b")
    now[0] = 0.5
    assert sum(rates.admits("a") for _ in range(100)) == 5
    now[0] = 1000.0
    assert sum(rates.admits("a") for _ in range(100)) == 10


def test_the_table_of_clients_is_bounded_and_frees_itself():
    now = [0.0]
    rates = Rates(10.0, clients=4, clock=lambda: now[0])
    assert [rates.admits(who) for who in range(6)] == [True] * 4 + [False] * 2
    assert rates.admits(0)
    now[0] = 0.11
    assert [rates.admits(who) for who in (7, 8, 9, 10)] == [True] * 3 + [False]
    now[0] = 10.0
    assert all(rates.admits(who) for who in range(100, 104))
    assert len(rates._buckets) == 4
