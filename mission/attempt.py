"""What is worth trying and must not keep anything else from being done."""

import logging
from collections.abc import Callable

from perception.failure import FailureError

log = logging.getLogger("mission")


def attempt(what: str, act: Callable[[], object]) -> bool:
    """Try it; whether it went well. A failure with a name is told in one line, an error of the program with its trace.

    Args:
        what: is not done if it fails, for the log.
    """
    try:
        act()
    except FailureError as error:
        log.warning("%s: %s", what, error)
    except Exception:
        log.exception("%s", what)
    else:
        return True
    return False
