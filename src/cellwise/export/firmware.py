"""The firmware's C as an estimator of this machine."""

from __future__ import annotations

from cellwise.estimate.fixed.fixed_step import FixedStep, Stepper
from cellwise.estimate.fixed.tables import FixedStepTables
from cellwise.export.host_library import HostLibrary


def host_stepper(tables: FixedStepTables) -> Stepper:
    """The C of some tables, by this machine's compiler, as the fixed step takes it."""
    library = HostLibrary(tables)
    return Stepper(
        tables,
        library.init,
        library.rows,
        library.power,
        library.remaining,
        library.set_health,
        library.pack(),
    )


class Firmware(FixedStep):
    """The fixed-step filter as compiled C, through cffi; parameters as :class:`FixedStep`."""

    name = "firmware"

    def _make(self, tables: FixedStepTables) -> Stepper:
        return host_stepper(tables)
