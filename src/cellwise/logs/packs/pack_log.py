"""What was measured of a pack: one current, the voltage of every cell, and flags of both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from cellwise.errors import InputError
from cellwise.logs.cell_log import CellLog
from cellwise.logs.packs.cells import CellFlag, cell_name, checked_cells, mean_voltage_V
from cellwise.typing import BoolArray, FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class PackLog:
    """Cells in series: one current, one voltage each.

    Parameters
    ----------
    mean : CellLog                the mean cell: current, temperature, mean of the cells' voltages
    cell_V : (n, cells) float     voltage of every cell [V]; NaN where it is missing or not believed
    names : tuple of str          ``cell_01``, ...
    balancing : (n, cells) bool or None      the cell's bypass is on
    pack_V : (n,) float or None   voltage of the whole pack [V], where it was measured
    flags : tuple of CellFlag     what is wrong with cells' voltages before any model is asked
    parallel : int                strings in parallel, of which the current is that of one

    Notes
    -----
    Cells of one pack need not be polled at one instant; how far apart they are is for
    :mod:`cellwise.pack` to find.
    """

    mean: CellLog
    cell_V: FloatArray
    names: tuple[str, ...]
    balancing: BoolArray | None = None
    pack_V: FloatArray | None = None
    flags: tuple[CellFlag, ...] = field(default=())
    parallel: int = 1

    def __len__(self) -> int:
        return len(self.mean)

    def __repr__(self) -> str:
        return f"PackLog({self.name or 'unnamed'}: {self.cells} cells, {len(self)} rows)"

    @property
    def name(self) -> str:
        """For people."""
        return self.mean.name

    @property
    def cells(self) -> int:
        """Number of cells with a column."""
        return len(self.names)

    @property
    def notices(self) -> tuple[str, ...]:
        """What a person should know: of the cells first, then of reading the log."""
        return (*dict.fromkeys(flag.text for flag in self.flags), *self.mean.notices)

    @property
    def difference_V(self) -> FloatArray:
        """Every cell's voltage minus the mean cell's [V], shape (n, cells)."""
        return np.asarray(self.cell_V - self.mean.voltage_V[:, None])

    @classmethod
    def from_arrays(
        cls,
        time_s: ArrayLike,
        current_A: ArrayLike,
        cell_V: ArrayLike,
        *,
        names: Sequence[str] | None = None,
        temperature_C: ArrayLike | None = None,
        charge_Ah: ArrayLike | None = None,
        pack_V: ArrayLike | None = None,
        balancing: ArrayLike | None = None,
        name: str = "",
        source: str = "",
        notices: Sequence[str] = (),
    ) -> Self:
        """A pack from arrays, checked.

        Parameters
        ----------
        time_s, current_A : (n,) float       positive current is discharge
        cell_V : (n, cells) float            a negative voltage is that of a cell being balanced
        names : sequence of str              None: ``cell_01``, ...
        temperature_C : (n,) float           of the pack
        charge_Ah : (n,) float               counter of the pack's current
        pack_V : (n,) float                  of the whole pack
        balancing : (n, cells) bool

        Raises
        ------
        InputError        shapes that do not agree, cells in millivolts, not two cells that measure
        """
        time = np.asarray(time_s, dtype=np.float64)
        volts = np.array(cell_V, dtype=np.float64)
        where = f"'{source or name}'" if source or name else "the pack"
        if volts.ndim != 2 or volts.shape[0] != time.size:
            raise InputError(
                f"cell voltages of shape {volts.shape} with {time.size} rows in {where}",
                f"shape ({time.size}, cells)",
                "Give one column for each cell and one row for each time.",
            )
        count = volts.shape[1]
        named = tuple(names or (cell_name(k + 1, count) for k in range(count)))
        if len(named) != count or len(set(named)) != count:
            raise InputError(
                f"{len(named)} names ({len(set(named))} different) for {count} cells in {where}",
                "one name for each cell",
                "Correct the names.",
            )
        bypass = None if balancing is None else np.array(balancing, dtype=np.bool_)
        pack = None if pack_V is None else np.asarray(pack_V, dtype=np.float64)
        volts, bypass, flags = checked_cells(volts, bypass, named, pack, where)
        mean = CellLog(
            time_s=time,
            current_A=np.asarray(current_A, dtype=np.float64),
            voltage_V=mean_voltage_V(volts),
            temperature_C=None if temperature_C is None else np.asarray(temperature_C, np.float64),
            charge_Ah=None if charge_Ah is None else np.asarray(charge_Ah, np.float64),
            name=name,
            source=source,
            format="pack",
            notices=tuple(notices),
        )
        return cls(mean, volts, named, bypass, pack, flags)

    def rows(self, rows: Any) -> Self:
        """The chosen rows, time kept."""

        def taken(a: Any) -> Any:
            return None if a is None else a[rows]

        return replace(
            self,
            mean=self.mean.rows(rows),
            cell_V=self.cell_V[rows],
            balancing=taken(self.balancing),
            pack_V=taken(self.pack_V),
        )

    def with_cells(self, cell_V: FloatArray) -> Self:
        """The same log with other cell voltages, shape (n, cells): mean and checks again."""
        mean = self.mean
        return type(self).from_arrays(
            mean.time_s,
            mean.current_A,
            cell_V,
            names=self.names,
            temperature_C=mean.temperature_C,
            charge_Ah=mean.charge_Ah,
            pack_V=self.pack_V,
            balancing=self.balancing,
            name=mean.name,
            source=mean.source,
            notices=mean.notices,
        )

    def columns(self) -> Mapping[str, FloatArray]:
        """The tidy form's columns: time, current, temperature, ``cell_01_V``, ..."""
        mean = self.mean
        found = {"time_s": mean.time_s, "current_A": mean.interval_current_A}
        if mean.temperature_C is not None:
            found["temperature_C"] = mean.temperature_C
        for k, name in enumerate(self.names):
            found[f"{name}_V"] = self.cell_V[:, k]
        return found
