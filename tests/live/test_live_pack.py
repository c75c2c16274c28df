"""The cells of a pack in a stream: JSON lines and CAN, a weak cell found, a state that goes on."""

from __future__ import annotations

import json
import math
import uuid

import numpy as np
import pytest

from cellwise import InputError
from cellwise.cell.model_file import write_model
from cellwise.cli import main
from cellwise.live import LiveFilter, Sample, open_source
from cellwise.live.samples import Readings
from cellwise.logs.files.source import ReadOptions
from cellwise.logs.formats.vehicle_signals import cell_number
from emulated_packs import Fault, emulated_pack

CELLS = 4
DBC = """VERSION ""

BU_: BMS

BO_ 256 BMS_Pack: 4 BMS
 SG_ PackCurrent : 0|16@1- (0.01,0) [-300|300] "A" BMS
 SG_ PackVoltage : 16|16@1+ (0.01,0) [0|900] "V" BMS

BO_ 300 BMS_Cells: 8 BMS
 SG_ CellVoltage01 : 0|16@1+ (1,0) [0|5000] "mV" BMS
 SG_ CellVoltage02 : 16|16@1+ (1,0) [0|5000] "mV" BMS
 SG_ CellVoltage03 : 32|16@1+ (1,0) [0|5000] "mV" BMS
 SG_ CellVoltage04 : 48|16@1+ (1,0) [0|5000] "mV" BMS
"""


@pytest.fixture(scope="module")
def weak():
    """A pack whose third cell begins 3 % lower."""
    return emulated_pack(CELLS, Fault(2, soc=-0.03), hours=2.0)


def lines(pack, unit="V"):
    """The pack as JSON lines, without a voltage of its own."""
    factor = 1000.0 if unit == "mV" else 1.0
    names = [f"cell_{k + 1:02d}_{unit}" for k in range(pack.cells)]
    for k in range(len(pack)):
        cells = dict(zip(names, (factor * pack.cell_V[k]).tolist(), strict=True))
        row = {"time_s": pack.mean.time_s[k], "current_A": pack.mean.current_A[k]}
        yield json.dumps(row | cells) + "\n"


def assert_the_weak_one(soc, of_mean):
    """Each cell's SOC apart from the mean: its own, as the pack was made, and the third one's."""
    own = np.random.default_rng(12345).normal(size=(CELLS, 4))[:, 2] * 0.003
    true = own - 0.03 * (np.arange(CELLS) == 2)
    np.testing.assert_allclose(np.array(soc) - np.mean(soc), true - np.mean(true), atol=5e-3)
    assert of_mean == pytest.approx(np.mean(soc), abs=0.02)


@pytest.mark.slow
def test_lines_with_cells_name_the_weak_one(weak, tmp_path, capsys):
    model, pack = weak
    write_model(model, tmp_path / "m.json")
    (tmp_path / "pack.jsonl").write_text("".join(lines(pack, "mV")))
    source = f"json:{tmp_path / 'pack.jsonl'}"
    assert main(["live", "--model", str(tmp_path / "m.json"), "--source", source,
                 "--cells", str(CELLS), "--json"]) == 0  # fmt: skip
    found = json.loads(capsys.readouterr().out)
    assert_the_weak_one(found["cells"]["soc"], found["soc"])
    assert all(len(values) == CELLS for values in found["cells"].values())


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 10])
def test_a_slow_stream_gives_the_same_cells(weak, every):
    """Rows of ten seconds, each with the mean current since the last: no gaps, no lost charge."""
    model, pack = weak
    live = LiveFilter(model, soc0=0.9, cells=CELLS)
    for k in range(every, len(pack), every):
        volts = tuple(pack.cell_V[k])
        current = float(np.mean(pack.mean.current_A[k - every + 1 : k + 1]))
        update = live.take(Sample(float(k), current, float(np.mean(volts)), 25.0, 0.0, volts))
    assert_the_weak_one(live.pack.columns()["cells"]["soc"], update.info.soc)


@pytest.mark.slow
def test_a_restart_keeps_the_cells(weak, tmp_path):
    model, pack = weak

    def sample(k):
        volts = tuple(pack.cell_V[k])
        return Sample(float(k), pack.mean.current_A[k], float(np.mean(volts)), 25.0, 0.0, volts)

    through = LiveFilter(model, soc0=0.9, cells=CELLS)
    stopped = LiveFilter(model, soc0=0.9, cells=CELLS)
    for k in range(2000):
        through.take(sample(k))
        stopped.take(sample(k))
    stopped.save(tmp_path / "state.json", now_s=5000.0)
    begun = LiveFilter(model, cells=CELLS)
    assert begun.resume(tmp_path / "state.json", now_s=5001.0)
    for k in range(2000, 2100):
        through.take(sample(k))
        begun.take(sample(k))
    for name in ("capacity_share", "resistance_scale"):
        ours, theirs = (one.pack.columns()["cells"][name] for one in (begun, through))
        np.testing.assert_allclose(ours, theirs, atol=2e-3)
    with pytest.raises(InputError, match="of 4 cells for a pack of 6"):
        LiveFilter(model, cells=6).resume(tmp_path / "state.json", now_s=5001.0)


def test_a_bus_gives_the_cells_by_the_names_of_their_signals(tmp_path):
    can = pytest.importorskip("can")
    cantools = pytest.importorskip("cantools")
    (tmp_path / "bms.dbc").write_text(DBC)
    database = cantools.database.load_file(str(tmp_path / "bms.dbc"))
    channel = uuid.uuid4().hex
    options = ReadOptions(dbc=tmp_path / "bms.dbc", series=4)
    with pytest.raises(InputError, match="signals of 4 cells' voltages"):
        open_source(f"can:virtual:{channel}", options, cells=6)
    stream = open_source(f"can:virtual:{channel}", options, cells=4)
    bus = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)

    def send(name, at, **signals):
        message = database.get_message_by_name(name)
        data = message.encode(signals)
        bus.send(can.Message(arbitration_id=message.frame_id, is_extended_id=False, data=data,
                             timestamp=at))  # fmt: skip

    volts = {f"CellVoltage0{k + 1}": 3700 + k for k in range(4)}
    send("BMS_Cells", 10.0, **volts)
    send("BMS_Pack", 10.1, PackCurrent=2.0, PackVoltage=14.8)
    send("BMS_Pack", 20.0, PackCurrent=2.0, PackVoltage=14.8)
    found = []
    for item in stream:
        if item is not None:
            found.append(item)
        if len(found) == 2:
            break
    stream.close()
    bus.shutdown()
    assert found[0].cell_V == pytest.approx((3.700, 3.701, 3.702, 3.703))
    assert found[0].voltage_V == pytest.approx(3.7)
    assert all(math.isnan(v) for v in found[1].cell_V)  # too long ago


@pytest.mark.parametrize(
    ("name", "number"),
    [("CellVoltage01", 1), ("VCell_12", 12), ("Cell3_Volt", 3), ("cell_07_V", 7), ("Cell96", 96),
     ("CellTemp1", None), ("PackVoltage", None), ("CellVoltageMax", None), ("Cell", None)],
)  # fmt: skip
def test_a_cell_is_known_by_the_name_of_its_signal(name, number):
    assert cell_number(name) == number


def test_wrong_packs_are_refused():
    for cells in (1, -3, 1001):
        with pytest.raises(InputError, match="2 to 1000 in series"):
            Readings(ReadOptions(), "auto", cells)
    with pytest.raises(InputError, match="cells of a pack in a ULog stream"):
        open_source("ulog:none.ulg", cells=4)
