"""export --can: what the written C packs, cantools unpacks by the written DBC."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from example_cells import curved_cell

cantools = pytest.importorskip("cantools", reason="no cantools: pip install cantools")

PROGRAM = """
#include <stdio.h>
#include <string.h>
#include "gauge.h"
static void show(const uint8_t *bytes, int n) {
  for (int k = 0; k < n; k++) printf("%02x", bytes[k]);
  printf("\\n");
}
int main(void) {
  uint8_t bytes[8];
  struct gauge_soc_t soc = {gauge_soc_soc_encode(63.21f), gauge_soc_soc_low_encode(58.4f),
    gauge_soc_soc_high_encode(68.02f), gauge_soc_status_encode(8194.0f)};
  show(bytes, gauge_soc_pack(bytes, &soc, sizeof bytes));
  struct gauge_remaining_t left = {gauge_remaining_time_encode(7200.0f),
    gauge_remaining_time_low_encode(6000.0f), gauge_remaining_time_high_encode(9000.0f)};
  show(bytes, gauge_remaining_pack(bytes, &left, sizeof bytes));
  struct gauge_power_t power = {gauge_power_discharge_encode(100.0f),
    gauge_power_discharge_low_encode(90.0f), gauge_power_charge_encode(40.0f),
    gauge_power_charge_low_encode(35.0f)};
  show(bytes, gauge_power_pack(bytes, &power, sizeof bytes));
}
"""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
def test_what_the_c_packs_the_database_unpacks(export, tmp_path):
    export("--can", tmp_path / "gauge.dbc")
    (tmp_path / "main.c").write_text(PROGRAM)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror"]
    subprocess.run(["gcc", *flags, "main.c", "gauge.c", "-o", "main"], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True)
    bus = cantools.database.load_file(tmp_path / "gauge.dbc")
    wanted = {
        "Soc": {"Soc": 63.21, "SocLow": 58.4, "SocHigh": 68.02, "Status": 8194},
        "Remaining": {"Time": 7200, "TimeLow": 6000, "TimeHigh": 9000},
        "Power": {"Discharge": 100, "DischargeLow": 90, "Charge": 40, "ChargeLow": 35},
    }
    for (name, values), line in zip(wanted.items(), done.stdout.split(), strict=True):
        found = bus.decode_message(name, bytes.fromhex(line))
        for key, value in values.items():
            factor = next(s for s in bus.get_message_by_name(name).signals if s.name == key).scale
            assert found[key] == pytest.approx(value, abs=0.51 * factor), (name, key)
        assert bus.decode_message(name, bus.encode_message(name, found)) == found
    assert len({m.frame_id for m in bus.messages}) == 3
    assert bus.get_message_by_name("Soc").signals[0].unit == "%"


def test_the_power_of_a_pack_has_room_in_its_signal(export, tmp_path):
    export("--can", tmp_path / "gauge.dbc", "--cells", 96)
    bus = cantools.database.load_file(tmp_path / "gauge.dbc")
    cell = curved_cell()
    most = max(s.maximum for s in bus.get_message_by_name("Power").signals)
    assert most >= 96 * 10 * cell.capacity_Ah * cell.ocv_V.max()
