"""The page's code, built for this machine once for all tests that call it."""

import pytest

from tests.web import native


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    """The library of ``native.build``; tests are skipped where ``native.NEEDS`` says so."""
    return native.build(tmp_path_factory.mktemp("native"), native.COMPILER)
