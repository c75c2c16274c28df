"""The exported folder as a module of somebody's tree: its manifest, build files, example in place.

The templates stand in ``firmware_ref/layouts``, a folder for each.
"""

from __future__ import annotations

from dataclasses import dataclass

from cellwise.errors import InputError
from cellwise.export.c_tables import firmware_folder
from cellwise.export.example import BUILD

# No build file of the Arduino tree reaches the compiler; fused operations would change bits.
UNFUSED = """\
#if defined(__clang__)
#pragma clang fp contract(off)
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#endif
"""


@dataclass(frozen=True)
class Layout:
    """Where a tree wants what: folders of sources and headers, the example's file; how it is used.

    ``example`` is None where a template is the example; ``vector`` is the folder of test_vector.h.
    """

    sources: str
    headers: str
    example: str | None
    vector: str
    use: str


LAYOUTS = {
    "cmake": Layout(
        *("src/", "include/", "example/example.c", "example/"),
        "    cmake -B build && cmake --build build && ctest --test-dir build\n\n"
        "or `add_subdirectory` of this folder, and link `@NAME@`.",
    ),
    "zephyr": Layout(
        *("src/", "include/", "samples/check/src/main.c", "samples/check/src/"),
        "    west build -b qemu_cortex_m3 samples/check -t run\n\n"
        "In an application: `EXTRA_ZEPHYR_MODULES` or the west manifest names this folder, "
        "`prj.conf` says `CONFIG_@UPPER@=y`.",
    ),
    "platformio": Layout(
        *("src/", "include/", "examples/check/src/main.c", "examples/check/src/"),
        "    pio run -d examples/check -t exec\n\n"
        "In a project: `lib_deps = @NAME@=symlink://path/of/this/folder`.",
    ),
    "arduino": Layout(
        *("src/", "src/", None, "examples/Check/"),
        "Put this folder into `libraries`, or *Sketch > Include Library > Add .ZIP Library*; then "
        "*Examples > @NAME@ > Check*. On a board without 32 KB of RAM keep the vector in flash.",
    ),
    "esp-idf": Layout(
        *("src/", "include/", "examples/check/main/main.c", "examples/check/main/"),
        "    idf.py -C examples/check build flash monitor\n\n"
        "In a project: this folder in `components`, or `override_path` in `idf_component.yml`.",
    ),
    "foxbms": Layout(
        *("", "", "example/example.c", "example/"),
        "Put this folder to `src/app/application/algorithm/state_estimation/soc/@NAME@` and name "
        "`@NAME@` as the SOC algorithm in `conf/bms/bms.json`. The model is that of a cell block: "
        "scale its capacity by the cells in parallel.",
    ),
}


def arranged(files: dict[str, str], layout: str, name: str, dt_s: float) -> dict[str, str]:
    """The files of a package where a tree wants them, with its own beside.

    Parameters
    ----------
    files : names and texts      of the flat package, before any prefix
    layout : str                 a key of :data:`LAYOUTS`
    name : str                   of the library

    Raises
    ------
    InputError        an unknown layout; a time step that is not a whole number of milliseconds,
                      which the foxBMS glue counts in
    """
    if layout not in LAYOUTS:
        raise InputError(f"layout '{layout}'", f"one of {', '.join(LAYOUTS)}", "Choose one.")
    milliseconds = round(1000.0 * dt_s)
    if layout == "foxbms" and abs(milliseconds - 1000.0 * dt_s) > 1e-6:
        raise InputError(
            f"a time step of {dt_s:g} s for foxBMS", "whole milliseconds", "Give `dt_s=0.1`, say."
        )
    wanted = LAYOUTS[layout]

    def filled(text: str) -> str:
        text = text.replace("@UPPER@", name.upper()).replace("@DT_MS@", str(milliseconds))
        return text.replace("@NAME@", name)

    found: dict[str, str] = {}
    for file, text in files.items():
        if file == "example.c":
            if wanted.example is not None:
                found[wanted.example] = as_application(text) if layout == "esp-idf" else text
        elif file == "test_vector.h":
            found[wanted.vector + file] = text
        elif file.endswith(".h"):
            found[wanted.headers + file] = text
        elif file.endswith(".c"):
            found[wanted.sources + file] = (UNFUSED if layout == "arduino" else "") + text
        else:
            found[file] = text.replace(BUILD, filled(wanted.use))
    folder = firmware_folder() / "layouts" / layout
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            text = filled(path.read_text(encoding="utf-8"))
            found[path.relative_to(folder).as_posix()] = text
    return found


def as_application(example: str) -> str:
    """The example for a tree whose entry is ``app_main``."""
    text = example.replace("int main(void)", "static int check(void)")
    return text + "\nvoid app_main(void);\nvoid app_main(void)\n{\n    (void)check();\n}\n"
