"""An impedance spectrum is no log, whatever its columns are called; a log of a grid's hertz is."""

from __future__ import annotations

import numpy as np
import pytest

from cellwise.errors import InputError
from cellwise.logs import read_log

HEADERS = (
    "EC-Lab ASCII FILE\nNb header lines : 4\n\nfreq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\ttime/s\t<Ewe>/V",
    "Frequency (Hz),Z' (Ohm),Z'' (Ohm),time_s,voltage_V,current_A",
    "f [Hz];Zreal [Ohm];Zimag [Ohm]",
    "Pt\tTime\tFreq\tZreal\tZimag\tZsig\tZmod\tZphz\tIdc\tVdc",
    "Frequenz [Hz];Impedanz [Ohm];Phase",
    "frequency,real,imag",
)


def rows_below(header, first):
    mark = next(m for m in "\t;," if m in header.splitlines()[-1])
    names = header.splitlines()[-1].split(mark)
    at = next(k for k, name in enumerate(names) if name.casefold().startswith("f"))
    rows = [mark.join("0.02" if k != at else f"{x:.4g}" for k in range(len(names))) for x in first]
    return "\n".join([header, *rows]) + "\n"


@pytest.mark.parametrize("header", HEADERS)
def test_it_is_refused_as_such(tmp_path, header):
    path = tmp_path / "eis.txt"
    path.write_text(rows_below(header, np.geomspace(1e4, 1e-2, 40)), encoding="utf-8")
    with pytest.raises(InputError, match=r"an impedance spectrum in .*no log over time"):
        read_log(path)


def test_a_log_beside_the_frequency_of_a_grid_is_read(tmp_path):
    time = np.arange(200.0)
    current = np.where(time % 40 < 20, 2.0, 0.0)
    hertz = 50.0 + 0.02 * np.sin(time)
    columns = (time, current, 3.7 - 0.05 * current - 1e-3 * time, hertz, np.full(200, 1.2))
    head = "time_s,current_A,voltage_V,Frequency (Hz),Impedance (mOhm)"
    path = tmp_path / "home.csv"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=head, comments="")
    assert len(read_log(path)) == 200
