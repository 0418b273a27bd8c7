"""The unwrapped ball of `support.lit_ball`."""

import pytest

from support.lit_ball import unwrapped_ball


@pytest.fixture(scope="module")
def ball():
    return unwrapped_ball()
