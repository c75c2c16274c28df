"""An export that certificates are of."""

from __future__ import annotations

import pytest

from cellwise.cli import main


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A stock model exported without a cross compiler's figures."""
    place = tmp_path_factory.mktemp("export") / "firmware"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cellwise.export.cross.cores_here", list)
        assert main(["export", "--model", "nmc-18650", "--dt", "5", "-o", str(place)]) == 0
    return place
