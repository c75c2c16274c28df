"""The prior over cells: classes, lineages left out, a model as the prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model import TABLES as FIELDS
from cellwise.cell.stock import stock_model, stock_names
from cellwise.errors import InputError
from cellwise.fit.population import SOC, ModelPrior, cell_classes, class_of
from cellwise.fit.rows import FitLog
from cellwise.fit.splines import OCV_KNOTS, TABLE_KNOTS, greville
from cellwise.fit.unknowns import FitSettings
from fit_cases import CAPACITY_AH, Truth, cells_like, log_of, prior_for, pulse_current

TRUTH = Truth()
AT_SOC = greville(TABLE_KNOTS)


def curves_of(lineage: str) -> list[np.ndarray]:
    stock = stock_model(lineage)
    return [np.interp(SOC, stock.soc, stock.ocv_at(25.0))]


@pytest.mark.parametrize("lineage", [*stock_names()])
def test_a_lineage_that_is_left_out_has_no_member(lineage):
    whole = {c.name: c for c in cell_classes()}
    for found in cell_classes(frozenset({lineage})):
        before = whole[found.name]
        assert len(found.ln_tables["r0"]) == len(before.ln_tables["r0"]) - 1
        for curve in curves_of(lineage):
            nearest = np.abs(found.ocv_V - curve).max(axis=1).min()
            assert nearest > 1e-3, f"a member of {found.name} has the curve of {lineage}"
        assert lineage in found.said()
    own = class_of(stock_model(lineage).chemistry)
    left = next(c for c in cell_classes(frozenset({lineage})) if c.name == own)
    assert len(left.ocv_V) < len(whole[own].ocv_V)


def test_a_name_that_is_no_lineage_is_refused_with_those_there_are():
    with pytest.raises(InputError, match=r"nobody.*nmc-18650"):
        cell_classes(frozenset({"nobody"}))


@pytest.mark.parametrize("cells", cell_classes(), ids=lambda c: c.name)
def test_covariances_are_positive_and_hold_the_members(cells):
    ocv = cells.ocv_covariance(greville(OCV_KNOTS))
    assert np.linalg.eigvalsh(ocv).min() > 0.0
    wide = np.sqrt(np.diag(cells.ocv_covariance(SOC)))
    away = np.abs(cells.ocv_V - cells.ocv_V.mean(axis=0)) / wide
    assert np.mean(away < 2.0) > 0.9
    for name in cells.ln_tables:
        for grid in (np.array([25.0]), np.array([-10.0, 10.0, 40.0])):
            mean, covariance = cells.table(name, AT_SOC, grid)
            assert mean.shape == (AT_SOC.size * grid.size,)
            assert np.linalg.eigvalsh(covariance).min() > -1e-9


def test_a_resistance_is_larger_in_the_cold_and_a_larger_cell_has_less():
    cells = cell_classes()[0]
    mean, _ = cells.table("r0", AT_SOC, np.array([0.0, 25.0]))
    cold, warm = mean.reshape(2, -1)
    assert np.all(cold > warm)
    prior, layout = prior_for([FitLog(log_of(pulse_current(1), TRUTH)[0], 1.0)], cells)
    np.testing.assert_allclose(
        prior.mean[layout.r0 : layout.r0 + layout.block], warm - np.log(CAPACITY_AH), atol=1e-12
    )


@pytest.mark.parametrize(
    ("chemistry", "name"),
    [("NMC", "layered"), ("NCA / graphite", "layered"), ("LiFePO4", "lfp"), ("LFP", "lfp"),
     ("LiCoO2", "layered"), ("", ""), ("LTO", "")],
)  # fmt: skip
def test_classes_of_chemistries_as_people_write_them(chemistry, name):
    assert class_of(chemistry) == name


def test_every_stock_model_is_of_a_class():
    assert {class_of(stock_model(name).chemistry) for name in stock_names()} == {"layered", "lfp"}


def test_a_model_as_the_prior_is_its_own_mean():
    model = stock_model("nmc-18650")
    cells = ModelPrior(model)
    np.testing.assert_allclose(
        cells.base().voltage_V, np.interp(SOC, model.soc, model.ocv_at(25.0))
    )
    grid = cells.grid_C
    assert set(grid) <= set(model.temperature_C)
    mean, covariance = cells.table("r0", AT_SOC, grid)
    for row, warm in zip(mean.reshape(grid.size, -1), grid, strict=True):
        at = model.at_temperature(float(warm))
        inside = (AT_SOC > 0.0) & (AT_SOC < 1.0)
        true = np.log(at.capacity_Ah * np.interp(AT_SOC, at.soc, at.r0_ohm[0]))
        np.testing.assert_allclose(row[inside], true[inside], atol=0.02)
    assert np.linalg.eigvalsh(covariance).min() > -1e-9


def test_a_model_that_errs_more_is_a_wider_prior():
    model = stock_model("nmc-18650")
    error = model.error
    twice = tuple(tuple(tuple(2.0 * v for v in row) for row in rows) for rows in error.std_V)
    double = replace(error, std_V=twice)
    narrow, wide = (
        ModelPrior(replace(model, error=e)).ocv_covariance(SOC) for e in (error, double)
    )
    assert np.all(np.diag(wide) >= np.diag(narrow))
    assert np.median(np.sqrt(np.diag(wide) / np.diag(narrow))) == pytest.approx(2.0, rel=0.1)


def test_a_common_factor_of_the_resistances_adds_to_what_each_may_be():
    log, soc = log_of(pulse_current(levels=1), Truth())
    logs = [FitLog(log, soc[0], soc0_std=0.01)]
    cells = cells_like(1.0)
    each, layout = prior_for(logs, cells, FitSettings(branches=2))
    common, _ = prior_for(logs, cells, FitSettings(branches=2, ln_resistance_std=0.5))
    free = np.ix_(each.free, each.free)
    u = layout.resistances()[each.free]  # of R0 and two branches
    assert u.sum() == 3 * layout.block
    np.testing.assert_allclose(
        np.linalg.inv(common.precision[free]),
        np.linalg.inv(each.precision[free]) + 0.25 * np.outer(u, u),
        atol=1e-4,
    )


def test_what_a_fit_does_not_have_is_not_free():
    log = FitLog(log_of(pulse_current(1), TRUTH)[0], 1.0)
    prior, layout = prior_for([log], cells_like(), FitSettings(branches=2))
    held = [layout.skew, layout.asinh, layout.capacity, layout.start, layout.sample, layout.past]
    assert not prior.free[held].any()
    loose = replace(log, soc0_std=0.1, sample_std=0.1, past_V=0.02)
    settings = FitSettings(branches=2, ln_capacity_std=0.05, skew=True, charge_transfer=True)
    prior, layout = prior_for([loose], cells_like(), settings)
    assert prior.free[held].all()
    expected = [1.0, 1.0, 0.05, 0.1, 0.1, 0.004]
    np.testing.assert_allclose(np.diag(prior.precision)[held], np.power(expected, -2.0))


def test_a_model_as_the_prior_has_tables_where_its_data_were():
    rows = np.arange(-40.0, 61.0, 10.0)
    model = stock_model("nca-18650")
    tables = {n: np.repeat(getattr(model, n)[:1], rows.size, axis=0) for n in FIELDS}
    valid = replace(model.validity, temperature_C=(1.0, 31.0))
    wide = replace(model, **tables, temperature_C=rows, effects=(), validity=valid)
    assert ModelPrior(wide).grid_C.tolist() == [0.0, 10.0, 20.0, 30.0]
    unknown = replace(wide, validity=replace(valid, temperature_C=None))
    assert ModelPrior(unknown).grid_C.tolist() == rows.tolist()
