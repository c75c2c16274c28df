"""A model as JSON: exact to the bit, whole or not at all, everything else refused."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cellwise.cell.model import TABLES
from cellwise.cell.model_file import (
    SCHEMA_VERSION,
    model_from_dict,
    model_to_dict,
    read_model,
    write_model,
)
from cellwise.errors import InputError
from example_cells import EFFECTS, linear_cell, random_model

ohms = arrays(np.float64, 11, elements=st.floats(1e-4, 1e-3))


def same(a, b):
    for name in (*TABLES, "temperature_C"):
        x, y = getattr(a, name), getattr(b, name)
        if x.shape != y.shape or x.tobytes() != y.tobytes():
            return False
    if [e.name for e in a.effects] != [e.name for e in b.effects]:
        return False
    for one, other in zip(a.effects, b.effects, strict=True):
        for field in fields(one):
            x, y = np.asarray(getattr(one, field.name)), np.asarray(getattr(other, field.name))
            if x.shape != y.shape or x.tobytes() != y.tobytes():
                return False
    plain = ("capacity_Ah", "charge_efficiency", "error", "voltage_min_V", "voltage_max_V",
             "name", "chemistry", "provenance", "validity")  # fmt: skip
    return all(getattr(a, name) == getattr(b, name) for name in plain)


@pytest.mark.parametrize("seed", range(5))
def test_round_trip_through_a_file_with_every_effect(tmp_path, seed):
    model = random_model(np.random.default_rng(seed), temperatures=1 + seed)
    model = replace(
        model,
        voltage_min_V=2.5,
        voltage_max_V=4.2,
        name="Zelle ä",
        chemistry="NCA",
        provenance={"r0_ohm": {"log": "hppc_p25", "standard_error": [1e-5, 2e-5]}},
    )
    path = tmp_path / "model.json"
    write_model(model, path)
    assert same(read_model(path), model)
    assert [p.name for p in tmp_path.iterdir()] == ["model.json"]


def test_the_file_says_its_schema_and_units():
    data = model_to_dict(linear_cell(effects=EFFECTS))
    assert data["schema_version"] == SCHEMA_VERSION
    assert data["kind"] == "cellwise.CellModel"
    assert len(data["soc"]) == len(data["r0_ohm"][0]) == 11
    assert {"name": "time_skew", "skew_s": 0.4} in data["effects"]


def broken(change):
    data = json.loads(json.dumps(model_to_dict(linear_cell(effects=EFFECTS))))
    change(data)
    return data


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(schema_version=2), "schema_version 2"),
        (lambda d: d.pop("schema_version"), "schema_version None"),
        (lambda d: d.update(kind="something else"), "not a cellwise model"),
        (lambda d: d.pop("r1_ohm"), "r1_ohm"),
        (lambda d: d.pop("capacity_Ah"), "capacity_Ah"),
        (lambda d: d.update(capacity_Ah=None), "wrong entry"),
        (lambda d: d.update(capacity_Ah=-1.0), "capacity_Ah"),
        (lambda d: d.update(r1_ohm=[[1.0, "x"]]), "wrong entry"),
        (lambda d: d.update(r1_ohm=[[1.0], [1.0, 2.0]]), "wrong entry"),
        (lambda d: d.update(r1_ohm=[[0.01] * 10]), "r1_ohm of shape"),
        (lambda d: d.update(r1_ohm=[[float("nan")] * 11]), "missing values"),
        (lambda d: d.update(soc=[0.0, 0.2, 1.0]), "not uniform"),
        (lambda d: d.update(soc=np.linspace(0, 1, 12).tolist()), "12 points"),
        (lambda d: d.update(error={"share": [0.1], "other": 1.0}), "unknown entry 'other'"),
        (lambda d: d["error"].update(std_V=0.01), "wrong entry"),
        (lambda d: d["error"].update(std_V=[[[0.01]], [[-0.01]]]), "model error"),
        (lambda d: d["error"].update(std_V=[]), "model error"),
        (lambda d: d.update(voltage_min_V="low"), "wrong entry"),
        (lambda d: d.update(effects=None), "wrong entry"),
        (lambda d: d.update(effects=[{"name": "gravity", "g": 9.81}]), "'gravity'"),
        (lambda d: d.update(effects=[{"m_V": 0.01}]), "effect None"),
        (
            lambda d: d.update(effects=[{"name": "time_skew", "lag_s": 1.0}]),
            "unknown entry 'lag_s'",
        ),
        (lambda d: d.update(effects=[{"name": "time_skew", "skew_s": -1.0}]), "skew_s"),
        (lambda d: d.update(effects=[{"name": "time_skew", "skew_s": "x"}]), "wrong entry"),
    ],
)
def test_what_is_not_such_a_model_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        model_from_dict(broken(change))


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "model.json"
    write_model(linear_cell(name="old"), path)
    with pytest.raises((InputError, ValueError, TypeError)):
        write_model(linear_cell(provenance={"bad": float("nan")}), path)
    assert read_model(path).name == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["model.json"]


def scaled(name, factor):
    return lambda d: d.update({name: (factor * np.array(d[name])).tolist()})


@pytest.mark.parametrize(
    ("change", "message", "hint"),
    [
        (scaled("ocv_V", 1e3), "ocv_V of 3200 to 4100 V", "not mV"),
        (scaled("ocv_V", 4.0), "ocv_V of", "pack in series"),
        (scaled("r0_ohm", 1e308), "r0_ohm with a drop of", "not mohm"),
        (
            lambda d: d.update(r1_ohm=[[2000.0] * 11]),
            "r1_ohm with a drop of 6000 V at 1C",
            "not mohm",
        ),
        (scaled("r2_ohm", 1e-300), "r2_ohm with a drop of", "mohm"),
        (scaled("capacity_Ah", 1e12), "capacity_Ah of 3e", "not mAh"),
        (scaled("capacity_Ah", 1e-300), "capacity_Ah of 3e-300", "Ah"),
        (scaled("tau2_s", 1e9), "tau2_s of", "Seconds"),
        (lambda d: d.update(temperature_C=[298.15]), "temperature_C of 298", "kelvin"),
        (lambda d: d.update(voltage_max_V=4200.0), "voltage_max_V of 4200 V", "not mV"),
        (lambda d: d["error"].update(std_V=[[[1e300]], [[0.0]]]), "std_V of the error", "not mV"),
        (lambda d: d["error"].update(share=[0.0, 1e9]), "share and charge_share", "share"),
        (
            lambda d: d["effects"][0].update(r3_ohm=90.0),
            "r3_ohm with a drop of 270 V at 1C",
            "not mohm",
        ),
    ],
)
def test_what_no_cell_can_have_is_refused(change, message, hint):
    with pytest.raises(InputError, match=message) as refused:
        model_from_dict(broken(change), "cell.json")
    assert hint in refused.value.action
    assert "cell.json" in refused.value.found


def test_a_misspelt_entry_is_told_its_name():
    def misspell(d):
        d["volatge_min_V"] = d.pop("voltage_min_V")

    with pytest.raises(InputError, match="expected 'voltage_min_V'"):
        model_from_dict(broken(misspell))


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.update(capacity_Ah=True),
        lambda d: d.update(capacity_Ah="3.0"),
        lambda d: d.update(capacity_Ah=10**400),
        lambda d: d.update(r0_ohm=[["0.03"] * 11]),
        lambda d: d.update(soc=[]),
        lambda d: d.update(ocv_V=[]),
        lambda d: d.update(ocv_V=[[10**400] * 11]),
        lambda d: d.update(temperature_C=[]),
        lambda d: d.update(schema_version=True),
        lambda d: d.update(error=None),
        lambda d: d["error"].update(std_V=None),
        lambda d: d["error"].update(scales_s=[0.1, float("inf")]),
        lambda d: d.update(effects=[[]]),
        lambda d: d.update(provenance=3),
    ],
)
def test_what_is_no_number_is_refused(change):
    with pytest.raises(InputError):
        model_from_dict(broken(change))


def test_what_cannot_be_read_back_is_not_written(tmp_path):
    path = tmp_path / "model.json"
    with pytest.raises(InputError, match="ocv_V of"):
        write_model(linear_cell(ocv_V=1e3 * np.linspace(3.2, 4.1, 11)), path)
    assert not path.exists()


def test_the_bounds_hold_for_cells_of_every_size(tmp_path):
    """A button cell of 1 mAh and 40 ohm, a cell of 3 kAh and 0.05 mohm."""
    for capacity, ohm in ((1e-3, 40.0), (3e3, 5e-5)):
        tables = {name: np.full(11, ohm) for name in ("r0_ohm", "r1_ohm", "r2_ohm")}
        model = linear_cell(capacity_Ah=capacity, **tables)
        write_model(model, tmp_path / "model.json")
        assert same(read_model(tmp_path / "model.json"), model)
