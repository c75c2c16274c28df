"""A model as JSON: exact to the bit, whole or not at all, everything else refused."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cellwise.cell.model import TABLES, ModelError
from cellwise.cell.model_file import (
    SCHEMA_VERSION,
    model_from_dict,
    model_to_dict,
    read_model,
    write_model,
)
from cellwise.errors import InputError
from example_cells import EFFECTS, linear_cell, random_model

positive = arrays(np.float64, 11, elements=st.floats(1e-300, 1e300, allow_subnormal=False))


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
             "name", "chemistry", "provenance")  # fmt: skip
    return all(getattr(a, name) == getattr(b, name) for name in plain)


@given(
    capacity=st.floats(1e-6, 1e6),
    r0=positive,
    r1=positive,
    ocv=arrays(np.float64, 11, elements=st.floats(-1e3, 1e3)),
    white=st.floats(0.0, 1.0),
    slow=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=30),
    name=st.text(max_size=20),
)
def test_round_trip_is_exact_to_the_bit(capacity, r0, r1, ocv, white, slow, name):
    model = linear_cell(
        capacity_Ah=capacity,
        r0_ohm=r0,
        r1_ohm=r1,
        ocv_V=np.sort(ocv),
        error=ModelError(white_V=white, slow_V=tuple(slow)),
        name=name,
    )
    assert same(model_from_dict(json.loads(json.dumps(model_to_dict(model)))), model)


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
        (lambda d: d.update(schema_version="1"), "schema_version '1'"),
        (lambda d: d.pop("schema_version"), "schema_version None"),
        (lambda d: d.update(kind="something else"), "not a cellwise model"),
        (lambda d: d.pop("r1_ohm"), "r1_ohm"),
        (lambda d: d.pop("capacity_Ah"), "capacity_Ah"),
        (lambda d: d.update(capacity_Ah="three"), "wrong entry"),
        (lambda d: d.update(capacity_Ah=None), "wrong entry"),
        (lambda d: d.update(capacity_Ah=-1.0), "capacity_Ah"),
        (lambda d: d.update(r1_ohm=[[1.0, "x"]]), "wrong entry"),
        (lambda d: d.update(r1_ohm=[[1.0], [1.0, 2.0]]), "wrong entry"),
        (lambda d: d.update(r1_ohm=[[0.01] * 10]), "r1_ohm of shape"),
        (lambda d: d.update(r1_ohm=[[float("nan")] * 11]), "missing values"),
        (lambda d: d.update(soc=[0.0, 0.2, 1.0]), "not uniform"),
        (lambda d: d.update(soc=np.linspace(0, 1, 12).tolist()), "12 points"),
        (lambda d: d.update(error={"white_V": 0.1, "other": 1.0}), "wrong entry"),
        (lambda d: d["error"].update(slow_V=0.01), "wrong entry"),
        (lambda d: d["error"].update(slow_V=[0.01, -0.01]), "model error"),
        (lambda d: d["error"].update(slow_V=[]), "model error"),
        (lambda d: d.update(voltage_min_V="low"), "wrong entry"),
        (lambda d: d.update(effects=None), "wrong entry"),
        (lambda d: d.update(effects=["hysteresis"]), "wrong entry"),
        (lambda d: d.update(effects=[{"name": "gravity", "g": 9.81}]), "'gravity'"),
        (lambda d: d.update(effects=[{"m_V": 0.01}]), "effect None"),
        (lambda d: d.update(effects=[{"name": "time_skew", "lag_s": 1.0}]), "wrong entry"),
        (lambda d: d.update(effects=[{"name": "time_skew", "skew_s": -1.0}]), "skew_s"),
        (lambda d: d.update(effects=[{"name": "time_skew", "skew_s": "x"}]), "wrong entry"),
    ],
)
def test_what_is_not_such_a_model_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        model_from_dict(broken(change))


@pytest.mark.parametrize("data", [None, [], 3, "model", {}, {"schema_version": 1}])
def test_other_json_is_refused(data):
    with pytest.raises(InputError, match="not a cellwise model"):
        model_from_dict(data)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_truncated_file_is_refused(tmp_path, share):
    path = tmp_path / "model.json"
    write_model(linear_cell(), path)
    text = path.read_text()
    path.write_text(text[: int(share * len(text))])
    with pytest.raises(InputError, match="not JSON"):
        read_model(path)


def test_no_file_and_no_text_are_refused(tmp_path):
    with pytest.raises(InputError, match="no readable model file"):
        read_model(tmp_path / "absent.json")
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match="no readable model file"):
        read_model(tmp_path / "binary.json")
    with pytest.raises(InputError):
        read_model(tmp_path)  # a folder


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "model.json"
    write_model(linear_cell(name="old"), path)
    with pytest.raises((InputError, ValueError, TypeError)):
        write_model(linear_cell(provenance={"bad": float("nan")}), path)
    assert read_model(path).name == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["model.json"]
