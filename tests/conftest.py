"""Runtime checks of shapes and types in the packages under test; where shared data lies."""

from __future__ import annotations

from pathlib import Path

import pytest
from jaxtyping import install_import_hook

install_import_hook(["sim", "estimators"], "beartype.beartype")

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
