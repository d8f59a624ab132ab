"""Runtime checks of shapes and types in the packages under test; where shared data lies."""

from __future__ import annotations

from pathlib import Path

import pytest
from beartype import BeartypeConf, FrozenDict, beartype
from hypothesis import settings
from jaxtyping import install_import_hook
from numpy.typing import ArrayLike

# PEP 484 welcomes an int where a float is asked for; at run time NumPy's protocol for sequences knows no tuple.
checked = beartype(conf=BeartypeConf(is_pep484_tower=True, hint_overrides=FrozenDict({ArrayLike: object})))
install_import_hook(["sim", "estimators"], f"{__name__}.checked")

# A loaded machine is no failure; the same examples every time, so that neither is luck.
settings.register_profile("pruefstand", deadline=None, derandomize=True)
settings.load_profile("pruefstand")

SHARED_DATA = Path(__file__).resolve().parent.parent.parent / "shared" / "data"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that need the shared data are skipped where that folder is absent."""
    if SHARED_DATA.is_dir():
        return
    for item in items:
        if item.get_closest_marker("shared_data"):
            item.add_marker(pytest.mark.skip(reason="no ../shared/data"))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    return SHARED_DATA
