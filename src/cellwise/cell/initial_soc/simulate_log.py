"""The public `simulate`: a log from a stated start, or from the one that explains it best."""

from __future__ import annotations

from cellwise.cell.initial_soc.initial_soc import initial_soc
from cellwise.cell.model import CellModel, check_is_model
from cellwise.cell.plausibility.cells_in_series import check_cells_in_series
from cellwise.cell.simulate import Simulation
from cellwise.cell.simulate import simulate as simulate_from
from cellwise.logs.cell_log import CellLog, check_is_log


def simulate(
    model: CellModel, log: CellLog, soc0: float | None = None, h0: float | None = None
) -> Simulation:
    """Simulate the terminal voltage of a log from a cell at rest at ``soc0``.

    Exact for constant current within each interval, at any time step. Over gaps the current is
    what :meth:`CellLog.known_current_A` says (the counter's charge, else a rest).

    Parameters
    ----------
    model : CellModel
    log : CellLog
    soc0 : float or None  SOC at the first row, 0..1; None: as ``cellwise simulate`` finds it (the
                          log's stated start, a rest at its beginning, or a fit of the log)
    h0 : float or None    hysteresis state at the first row, -1 (after a discharge) to 1 (after a
                          charge); None: +1 from the upper half of SOC, -1 from the lower

    Returns
    -------
    Simulation            its ``soc0`` is the start taken

    Raises
    ------
    InputError            soc0 outside 0..1; without a start, a pack read as one cell
    """
    check_is_model(model)
    check_is_log(log)
    if soc0 is None:
        check_cells_in_series(model, log)
        soc0 = initial_soc(model, log, likeliest=True, whole_log=True).soc
    return simulate_from(model, log, soc0, h0)
