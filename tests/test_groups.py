"""Tests that share fixtures and compiled programs run in one worker."""

import pytest


def test_xdist_knows_the_groups(request):
    """It does so by the names of the tests; spread over the workers they take several times as long."""
    if not request.config.getoption("loadgroup", False):
        pytest.skip("runs in the workers of --dist loadgroup only")
    assert request.node.nodeid.endswith("@test_groups")
