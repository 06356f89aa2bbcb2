"""What the tests here assert by way of others says as much as what they assert themselves."""

import pytest

pytest.register_assert_rewrite(
    *(f"tests.scenarios.{name}" for name in ("kept", "monitor", "ordeal", "play", "saga", "scripted", "wired"))
)
