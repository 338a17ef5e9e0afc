"""Scenes that the tests share, and which of them run: long forms only with SUTURA_FULL=1."""

import os
from pathlib import Path

import pytest

import sutura

#: Of the checkout.
ROOT = Path(__file__).parents[2]

FULL = bool(os.environ.get("SUTURA_FULL"))


def pytest_collection_modifyitems(config, items):
    if FULL:
        return
    long = [item for item in items if item.get_closest_marker("full")]
    # Left out by name, not skipped as if something were missing.
    config.hook.pytest_deselected(items=long)
    items[:] = [item for item in items if item not in long]


SLAB = {
    "name": "slab",
    "mesh": {"slab": {"size_m": [0.06, 0.06, 0.03], "divisions": [6, 6, 3]}},
    "tissue": {"model": "linear", "youngs_modulus_pa": 15e3, "poisson_ratio": 0.45},
    "fixed": [{"plane": {"axis": "z", "at_m": -0.03}}],
    "tool": [{"radius_m": 0.014}],
}


@pytest.fixture
def slab() -> dict:
    """A description that a test may change."""
    import copy

    return copy.deepcopy(SLAB)


@pytest.fixture
def solver(slab) -> sutura.Solver:
    return sutura.Solver(sutura.scene(slab))
