"""The firmware's C as an estimator of this machine: compiled for a model, called by cffi."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from copy import copy
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellwise.errors import InputError, not_installed
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.estimate.fixed.stepper import Stepper
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.export.c_tables import STRICT_FLAGS, firmware_folder, prefixed, put, write_sources
from cellwise.printing.firmware import PUBLIC

DECLARATIONS = """
uint32_t cellwise_init(const void *model, void *x, float soc, float soc_variance);
void cellwise_rows(const void *model, void *x, const void *in, void *out, uint32_t samples);
uint32_t cellwise_bank_init(const void *model, void *bank, void *of, uint32_t count, float soc,
                            float soc_variance);
void cellwise_bank_rows(const void *model, void *bank, void *of, uint32_t count, const void *in,
                        void *out, uint32_t samples);
void cellwise_power(const void *model, const void *x, void *out);
void cellwise_remaining(const void *model, const void *x, float load_A, bool holds_power,
                        void *out);
void cellwise_plan(const void *model, const void *x, const void *phases, uint32_t count,
                   bool holds_power, float above, void *out);
uint32_t cellwise_set_health(const void *model, void *x, float share, float scale);
void cellwise_cells_init(const void *model, void *cells, uint32_t count);
void cellwise_pack_rows(const void *model, void *x, void *cells, uint32_t count, void *in,
                        const void *voltage_V, void *out, uint32_t samples);
void cellwise_cells_of(const void *model, const void *x, const void *cells, uint32_t count,
                       void *out);
void cellwise_soh_init(const void *model, void *soh);
void cellwise_soh_rows(const void *model, void *x, void *soh, const void *in, void *out,
                         uint32_t samples);
uint32_t cellwise_patched_rows(const void *model, const void *from, void *x, const void *in,
                               void *out, uint32_t samples);
uint32_t cellwise_patched_bank_rows(const void *model, const void *from, void *bank, void *of,
                                    uint32_t count, const void *in, void *out, uint32_t samples);
void cellwise_soh_of(const void *model, void *soh, void *out);
void cellwise_keep(void *into, const void *x, const void *newest);
uint32_t cellwise_newest_slot(const void *first, const void *second);
uint32_t cellwise_restore(const void *model, void *x, const void *from, uint32_t age_s);
uint32_t cellwise_bank_restore(const void *model, void *bank, void *of, uint32_t count,
                               const void *from, uint32_t age_s);
void cellwise_pack_power(const void *model, const void *x, const void *cells, uint32_t count,
                         void *out);
void cellwise_sketch_init(const void *model, void *sketch, uint32_t unit);
void cellwise_sketch_rows(const void *model, void *x, void *sketch, const void *in, void *out,
                          uint32_t samples);
extern const char cellwise_cell[];
"""


class LoadedLibrary(NamedTuple):
    """A compiled library, how Python calls it, and what its names begin with."""

    ffi: Any
    library: Any
    prefix: str

    @property
    def cell(self) -> Any:
        """The tables that are compiled in."""
        return getattr(self.library, f"{self.prefix}_cell")

    def call(self, name: str, *handed: Any) -> Any:
        """A function of the C by the name of the step's; of an array its memory."""
        public = PUBLIC.get(name, f"cellwise_{name}").replace("cellwise", self.prefix, 1)
        memory = [self.ffi.from_buffer(a) if isinstance(a, np.ndarray) else a for a in handed]
        return getattr(self.library, public)(*memory)


class Firmware(FixedStep):
    """The fixed-step filter as compiled C, through cffi; parameters as :class:`FixedStep`."""

    name = "firmware"

    def _make(self, tables: FixedStepTables) -> Stepper:
        return HostLibrary(tables)


class HostLibrary(Stepper):
    """The compiled C of one set of tables.

    Parameters
    ----------
    compiler : sequence of str or None    command and flags; None: $CC or cc with -O2
    loaded : LoadedLibrary or None        compiled before; None: it is compiled now

    Raises
    ------
    InputError        no C compiler, no cffi, or C that does not compile
    """

    def __init__(
        self,
        tables: FixedStepTables,
        compiler: Sequence[str] | None = None,
        loaded: LoadedLibrary | None = None,
    ) -> None:
        super().__init__(tables, self._call)
        if loaded is None:
            with tempfile.TemporaryDirectory(prefix="cellwise-") as folder:
                path = build_library(tables, Path(folder), compiler or host_compiler())
                loaded = load_library(path)
        self.loaded = loaded
        self._model = loaded.cell

    def on(self, tables: FixedStepTables) -> HostLibrary:
        """The same code on other tables of the same options and time step."""
        found = copy(self)
        Stepper.__init__(found, tables, found._call)
        found._model = self.loaded.ffi.from_buffer(tables.to_bytes())
        return found

    def model_bytes(self) -> bytes:
        """The model as it stands in the library's read-only memory."""
        return bytes(self.loaded.ffi.buffer(self._model, self.tables.flash_bytes))

    def _call(self, name: str, *handed: Any) -> Any:
        return self.loaded.call(name, self._model, *handed)


def host_compiler() -> list[str]:
    """$CC with its flags, else cc, gcc or clang, at -O2.

    Raises
    ------
    InputError        none is there
    """
    named = shlex.split(os.environ.get("CC", ""))
    for command in [named] if named else [["cc"], ["gcc"], ["clang"]]:
        if shutil.which(command[0]):
            return [*command, "-O2"]
    raise InputError(
        "no C compiler", "cc, gcc or clang, or $CC", "Install one: apt-get install gcc."
    )


def build_library(tables: FixedStepTables, folder: Path, compiler: Sequence[str]) -> Path:
    """Compile the C of a model into a shared library in ``folder``.

    Raises
    ------
    InputError        the compiler refuses
    """
    put(write_sources(tables, "0" * 64), folder)
    return compile_rows(folder, "cellwise", compiler)


def compile_rows(folder: Path, prefix: str, compiler: Sequence[str]) -> Path:
    """Compile exported sources, and many steps in one call, into a shared library in ``folder``.

    Raises
    ------
    InputError        the compiler refuses
    """
    name = "port/host_rows.c"
    text = (firmware_folder() / name).read_text(encoding="utf-8")
    if prefix != "cellwise":
        headers = {f"cellwise_{part}.h": "" for part in ("ekf", "soh", "sketch", "store")}
        text = prefixed({name: text, **headers}, prefix)[f"port/{prefix}_host_rows.c"]
    put({name: text}, folder)
    library = folder / "librows.so"
    parts = (f"{prefix}_ekf.c", f"{prefix}_store.c", "*cell_table.c")
    sources = [str(path) for part in parts for path in folder.glob(part)]
    command = [*compiler, *STRICT_FLAGS, "-shared", "-fPIC", "-o", str(library), *sources]
    compile_c([*command, str(folder / name)])
    return library


def compile_c(command: Sequence[str]) -> None:
    """Run a compiler.

    Raises
    ------
    InputError        it refuses
    """
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise InputError(
            f"C that {command[0]} does not compile: {done.stderr.strip()[:300]}",
            "a C99 compiler with IEEE 754 float",
            "Set $CC to another compiler.",
        )


def need_package(name: str) -> list[str]:
    """Folders of a package that is not imported here.

    Raises
    ------
    InputError        it is missing
    """
    found = find_spec(name)
    if found is None:
        raise not_installed(name, "a compiled export")
    return list(found.submodule_search_locations or ())


def load_library(path: Path, prefix: str = "cellwise") -> LoadedLibrary:
    """A compiled library as Python calls it.

    Raises
    ------
    InputError        no cffi
    """
    try:
        from cffi import FFI
    except ImportError as error:
        raise not_installed("cffi", "the exported C in Python") from error
    ffi = FFI()
    ffi.cdef(DECLARATIONS.replace("cellwise_", f"{prefix}_"))
    return LoadedLibrary(ffi, ffi.dlopen(str(path)), prefix)
