"""Exports that certificates are of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_error import ModelError
from cellwise.cell.model_file import write_model
from cellwise.cell.posterior import CAPACITY, POINTS, Posterior
from cellwise.cell.stock import stock_model
from cellwise.cli import main


def exported(model, place):
    """A model exported without a cross compiler's figures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cellwise.export.cross.cores_here", list)
        assert main(["export", "--model", str(model), "--dt", "5", "-o", str(place)]) == 0
    return place


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A stock model's export."""
    return exported("nmc-18650", tmp_path_factory.mktemp("export") / "firmware")


@pytest.fixture
def of_capacity_std(tmp_path):
    """Exports of a model, a cell's own, whose capacity is known to a share of it."""

    def export(std, name="nmc-18650"):
        nothing = np.zeros((1, POINTS))
        fitted = Posterior((CAPACITY,), np.eye(1), np.array([std]), nothing, nothing)
        error = ModelError.of_white_and_slow(0.002, 0.005)
        path = tmp_path / f"model_{std:g}.json"
        write_model(replace(stock_model(name), error=error, posterior=fitted), path)
        return exported(path, tmp_path / f"firmware_{std:g}")

    return export
