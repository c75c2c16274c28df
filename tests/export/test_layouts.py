"""export --layout: each tree builds its folder, and the example finds every bit.

CMake and PlatformIO's manifest are the real ones. Zephyr's and ESP-IDF's CMake functions, Arduino's
and foxBMS's headers are stood in for by a few lines: what is tested is our side of them.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cellwise.cell.plausibility.validity import Validity
from cellwise.estimate.status import SEQUENCE_GAP, TEMPERATURE_INVALID
from cellwise.export.c_tables import STRICT_FLAGS, WARNING_FLAGS
from example_cells import curved_cell

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
PLACES = os.pathsep.join((os.environ["PATH"], str(Path(sys.executable).parent)))  # fmpy brings it
CMAKE, CTEST = (shutil.which(tool, path=PLACES) for tool in ("cmake", "ctest"))
needs_cmake = pytest.mark.skipif(CMAKE is None, reason="no cmake: apt-get install cmake")
BITS = "every bit as expected"


pytestmark = pytest.mark.usefixtures("no_cross_compiler")


@pytest.fixture
def exported(export, tmp_path):
    """The folder of a layout as the command writes it."""

    def run(layout, *more, **of):
        place = tmp_path / "out"
        told = export("--dt", 1, "-o", place, "--layout", layout, *more, **of)
        assert all((place / name).is_file() for name in told["files"])
        return place

    return run


def run(*command, cwd=None):
    done = subprocess.run(
        [str(c) for c in command], cwd=cwd, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-2000:]
    return done.stdout


@needs_cmake
@needs_gcc
@pytest.mark.parametrize("prefix", ["", pytest.param("nmc", marks=pytest.mark.slow)])
def test_cmake_builds_it_and_its_test_passes(exported, tmp_path, prefix):
    place = exported("cmake", *(["--prefix", prefix] if prefix else []))
    run(CMAKE, "-S", place, "-B", tmp_path / "build")
    run(CMAKE, "--build", tmp_path / "build")
    name = prefix or "cellwise"
    assert f"{name}_every_bit" in run(CTEST, "--test-dir", tmp_path / "build")
    assert BITS in run(tmp_path / "build" / f"{name}_example")


ZEPHYR = """
cmake_minimum_required(VERSION 3.16)
project(tree C)
set(CONFIG_CELLWISE y)
macro(zephyr_library_named name)
  set(lib ${name})
  add_library(${name} STATIC)
endmacro()
macro(zephyr_library_sources)
  target_sources(${lib} PRIVATE ${ARGN})
endmacro()
macro(zephyr_include_directories)
  target_include_directories(${lib} PUBLIC ${ARGN})
endmacro()
macro(zephyr_library_compile_options)
  target_compile_options(${lib} PRIVATE ${ARGN})
endmacro()
add_subdirectory(out)
add_executable(app out/samples/check/src/main.c)
target_link_libraries(app cellwise)
"""


@pytest.mark.slow
@needs_cmake
@needs_gcc
def test_zephyr_takes_the_module(exported, tmp_path):
    yaml = pytest.importorskip("yaml")
    place = exported("zephyr")
    module = yaml.safe_load((place / "zephyr/module.yml").read_text())
    assert module["name"] == "cellwise"
    assert (place / module["build"]["cmake"] / "CMakeLists.txt").is_file()
    assert (place / module["build"]["kconfig"]).is_file()
    sample = yaml.safe_load((place / module["samples"][0] / "check/sample.yaml").read_text())
    assert sample["tests"]["sample.cellwise.check"]["harness_config"]["regex"] == [BITS]
    (tmp_path / "CMakeLists.txt").write_text(ZEPHYR)
    run(CMAKE, "-S", tmp_path, "-B", tmp_path / "build")
    run(CMAKE, "--build", tmp_path / "build")
    assert BITS in run(tmp_path / "build/app")


def test_zephyrs_kconfig_has_the_symbol_that_the_sample_sets(exported, tmp_path):
    kconfiglib = pytest.importorskip("kconfiglib", reason="no kconfiglib: pip install kconfiglib")
    place = exported("zephyr", "--prefix", "nmc")
    found = kconfiglib.Kconfig(str(place / "Kconfig"))
    assert "NMC" in found.syms
    assert "CONFIG_NMC=y" in (place / "samples/check/prj.conf").read_text()


@pytest.mark.slow
@needs_gcc
def test_platformio_takes_the_manifest_and_the_example_compiles(exported, tmp_path):
    place = exported("platformio")
    manifest = json.loads((place / "library.json").read_text())
    assert all((place / "examples/check" / f).is_file() for f in manifest["examples"][0]["files"])
    build = manifest["build"]
    sources = sorted((place / build["srcDir"]).glob("*.c"))
    example = place / "examples/check/src/main.c"
    run("gcc", "-std=gnu99", "-O2", *build["flags"], "-I", place / build["includeDir"], example,
        *sources, "-o", tmp_path / "app")  # fmt: skip
    assert BITS in run(tmp_path / "app")
    parser = pytest.importorskip("platformio.package.manifest.parser", reason="no platformio")
    from platformio.package.manifest.schema import ManifestSchema

    read = parser.ManifestParserFactory.new_from_file(str(place / "library.json")).as_dict()
    assert read.pop("license") == "MIT"  # its check fetches the list of licences
    assert ManifestSchema().load_manifest(read)["name"] == "cellwise"


ARDUINO = """
#include <cstdio>
#include <cstring>
struct { void begin(long) {} void println(const char *text) { std::puts(text); } } Serial;
#include "Check.ino"
int main() { setup(); }
"""


@pytest.mark.slow
@needs_gcc
def test_arduino_takes_the_library_and_the_sketch_finds_every_bit(exported, tmp_path):
    place = exported("arduino")
    lines = (place / "library.properties").read_text().splitlines()
    properties = dict(line.split("=", 1) for line in lines)
    wanted = {"name", "version", "author", "maintainer", "sentence", "paragraph", "category"}
    assert wanted | {"url", "architectures"} <= set(properties)
    assert (place / "src" / properties["includes"]).is_file()
    (tmp_path / "main.cpp").write_text(ARDUINO)
    for source in (place / "src").glob("*.c"):
        run("gcc", "-std=gnu11", "-O2", "-c", source, "-o", tmp_path / f"{source.stem}.o")
    run("g++", "-std=gnu++11", "-I", place / "src", "-I", place / "examples/Check",
        tmp_path / "main.cpp", *tmp_path.glob("*.o"), "-o", tmp_path / "app")  # fmt: skip
    assert run(tmp_path / "app") == BITS + "\n"


IDF = """
cmake_minimum_required(VERSION 3.16)
project(tree C)
function(idf_component_register)
  cmake_parse_arguments(c "" "" "SRCS;INCLUDE_DIRS" ${ARGN})
  get_filename_component(name ${CMAKE_CURRENT_SOURCE_DIR} NAME)
  add_library(${name} STATIC ${c_SRCS})
  target_include_directories(${name} PUBLIC ${c_INCLUDE_DIRS})
  set(COMPONENT_LIB ${name} PARENT_SCOPE)
endfunction()
add_subdirectory(out)
add_subdirectory(out/examples/check/main)
target_link_libraries(main PUBLIC out)
file(WRITE ${CMAKE_BINARY_DIR}/entry.c "void app_main(void); int main(void) { app_main(); }")
add_executable(app ${CMAKE_BINARY_DIR}/entry.c)
target_link_libraries(app main)
"""


@pytest.mark.slow
@needs_cmake
@needs_gcc
def test_esp_idf_takes_the_component(exported, tmp_path):
    yaml = pytest.importorskip("yaml")
    place = exported("esp-idf")
    (tmp_path / "CMakeLists.txt").write_text(IDF)
    run(CMAKE, "-S", tmp_path, "-B", tmp_path / "build")
    run(CMAKE, "--build", tmp_path / "build")
    assert BITS in run(tmp_path / "build/app")
    needs = yaml.safe_load((place / "examples/check/main/idf_component.yml").read_text())
    told = needs["dependencies"]["cellwise"]["override_path"]
    assert (place / "examples/check/main" / told).resolve() == place.resolve()
    manager = pytest.importorskip("idf_component_tools.manager", reason="no idf-component-manager")
    assert str(manager.ManifestManager(place, "cellwise").load().version) == "1.0.0"


FOXBMS = {
    "os.h": "#include <stdint.h>\nuint32_t OS_GetTickCount(void);\n",
    "database.h": """
#pragma once
#include <stdbool.h>
#include <stdint.h>
#define BS_NR_OF_STRINGS 2u
#define BS_POSITIVE_DISCHARGE_CURRENT (false)
typedef enum { DATA_BLOCK_ID_MIN_MAX, DATA_BLOCK_ID_PACK_VALUES } DATA_BLOCK_ID_e;
typedef struct { DATA_BLOCK_ID_e uniqueId; } DATA_BLOCK_HEADER_s;
typedef struct { DATA_BLOCK_HEADER_s header; int16_t averageCellVoltage_mV[2];
  uint16_t validMeasuredCellVoltages[2]; uint16_t validMeasuredCellTemperatures[2];
  float averageTemperature_ddegC[2]; } DATA_BLOCK_MIN_MAX_s;
typedef struct { DATA_BLOCK_HEADER_s header; int32_t stringCurrent_mA[2];
  uint8_t invalidStringCurrent[2]; } DATA_BLOCK_PACK_VALUES_s;
typedef struct {
  float averageSoc_perc[2], minimumSoc_perc[2], maximumSoc_perc[2]; } DATA_BLOCK_SOC_s;
void read_blocks(void *one, void *two);
#define PICK(_1, _2, NAME, ...) NAME
#define ONE(a) read_blocks(a, 0)
#define TWO(a, b) read_blocks(a, b)
#define DATA_READ_DATA(...) PICK(__VA_ARGS__, TWO, ONE, 0)(__VA_ARGS__)
""",
    "state_estimation.h": """
#include <math.h>
#include "database.h"
void SE_InitializeStateOfCharge(DATA_BLOCK_SOC_s *pSocValues, bool ccPresent, uint8_t stringNumber);
void SE_CalculateStateOfCharge(DATA_BLOCK_SOC_s *pSocValues);
float_t SE_GetStateOfChargeFromVoltage(int16_t voltage_mV);
""",
    "main.c": """
#include <stdio.h>
#include "os.h"
#include "state_estimation.h"
#include <string.h>
#include "soc_cellwise.h"
static unsigned char fram[2][2][4096];
static void take(uint8_t s, uint8_t slot, void *to, uint32_t n) { memcpy(to, fram[s][slot], n); }
static void keep(uint8_t s, uint8_t slot, const void *from, uint32_t n) {
  memcpy(fram[s][slot], from, n); }
static uint32_t now_ms = 0xFFFF0000u; /* it wraps within the hour */
static int32_t current_mA = 0;
static bool is_valid = true; /* average of none: 0 */
uint32_t OS_GetTickCount(void) { return now_ms; }
void read_blocks(void *one, void *two) {
  DATA_BLOCK_MIN_MAX_s *cells = one;
  for (int s = 0; s < 2; s++) {
    cells->averageCellVoltage_mV[s] = is_valid ? 3700 : 0;
    cells->validMeasuredCellVoltages[s] = is_valid && two == 0;
    cells->averageTemperature_ddegC[s] = is_valid ? 250.0f : 0.0f;
    cells->validMeasuredCellTemperatures[s] = is_valid; }
  if (two != 0) { DATA_BLOCK_PACK_VALUES_s *pack = two;
    for (int s = 0; s < 2; s++) { pack->stringCurrent_mA[s] = s * current_mA;
      pack->invalidStringCurrent[s] = 0; } }
}
int main(void) {
  DATA_BLOCK_SOC_s soc;
  const SOC_STORE_s store = {take, keep};
  SE_SetStateOfChargeStore(&store);
  SE_InitializeStateOfCharge(&soc, false, 0u);
  SE_InitializeStateOfCharge(&soc, false, 1u);
  printf("%f %f\\n", soc.averageSoc_perc[0], soc.averageSoc_perc[1]);
  current_mA = -1000; /* discharge, where positive is charge */
  for (int k = 0; k < 36000; k++) { now_ms += 100u; SE_CalculateStateOfCharge(&soc); }
  printf("%f %f %f\\n", soc.averageSoc_perc[0], soc.averageSoc_perc[1], soc.minimumSoc_perc[1]);
  now_ms += 60000u;
  SE_CalculateStateOfCharge(&soc);
  printf("%u %d\\n", SE_GetStateOfChargeStatus(1u), SE_IsStateOfChargeValid(1u));
  SE_InitializeStateOfCharge(&soc, false, 1u);
  printf("%f\\n", soc.averageSoc_perc[1]);
  fram[1][0][40] ^= 1u;
  fram[1][1][40] ^= 1u;
  SE_InitializeStateOfCharge(&soc, false, 1u);
  printf("%f\\n", soc.averageSoc_perc[1]);
  SE_CalculateStateOfCharge(&soc);
  now_ms += 500u;
  SE_CalculateStateOfCharge(&soc);
  SE_KeepStateOfCharge(1u);
  const float kept = soc.averageSoc_perc[1];
  SE_InitializeStateOfCharge(&soc, false, 1u);
  printf("%f %f\\n", kept, soc.averageSoc_perc[1]);
  is_valid = false;
  memset(fram, 0, sizeof fram);
  SE_InitializeStateOfCharge(&soc, false, 1u);
  printf("%f %f", soc.averageSoc_perc[1], soc.maximumSoc_perc[1] - soc.minimumSoc_perc[1]);
  now_ms += 1000u;
  SE_CalculateStateOfCharge(&soc);
  printf(" %u\\n", SE_GetStateOfChargeStatus(1u));
}
""",
}


@pytest.mark.slow
@needs_gcc
def test_foxbms_calls_it_and_an_hour_at_1_A_takes_its_charge(exported, tmp_path):
    seen = Validity(soc=(0.0, 1.0), temperature_C=(0.0, 40.0), current_A=(-5.0, 9.0))
    place = exported("foxbms", model=curved_cell(validity=seen))  # its step reads the temperature
    for name, text in FOXBMS.items():
        (tmp_path / name).write_text(text)
    sources = [
        place / f"{n}.c" for n in ("soc_cellwise", "cellwise_ekf", "cellwise_store", "cell_table")
    ]
    run("gcc", *STRICT_FLAGS, *(f for f in WARNING_FLAGS if f != "-Wfloat-equal"), "-O2", "-I",
        tmp_path, "-I", place, *sources, "-c", cwd=tmp_path)  # fmt: skip
    run("gcc", "-std=gnu99", "-I", tmp_path, tmp_path / "main.c", *tmp_path.glob("*.o"), "-lm",
        "-I", place, "-o", tmp_path / "app")  # fmt: skip
    lines = [line.split() for line in run(tmp_path / "app").splitlines()]
    before, after, status, restored, damaged, kept, unseen = lines
    model = curved_cell()
    assert float(before[0]) == pytest.approx(float(before[1]))
    assert 0 < float(before[0]) < 100
    assert float(after[0]) == pytest.approx(float(before[0]), abs=0.01)
    taken = float(before[1]) - float(after[1])
    assert taken == pytest.approx(100.0 / model.capacity_Ah, rel=1e-3)
    assert float(after[2]) < float(after[1])
    assert int(status[0]) & SEQUENCE_GAP
    assert status[1] == "0"  # for an hour no cell voltage was valid
    assert float(restored[0]) == pytest.approx(float(after[1]), abs=taken / 5.0)  # ten minutes
    assert float(damaged[0]) == pytest.approx(float(before[1]))  # from the voltage again
    assert kept[0] == kept[1]  # before the power goes
    assert float(unseen[0]) == pytest.approx(50.0)  # no voltage is there: not that of 0 V
    assert float(unseen[1]) == 100.0
    assert int(unseen[2]) & TEMPERATURE_INVALID  # nor 0 degC
    # The wscript is Python that waf calls with a build context.
    run(sys.executable, "-m", "py_compile", place / "wscript")
