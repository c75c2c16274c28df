"""No filter may be worse than not filtering: known starts, and starts that are wrong under load.

One Panasonic model of all temperatures, judged on drives that are not in its fit. Coulomb counting
with the log's own current is the referee of the first, the tester's counter over a laboratory's
capacity that of both. Drives of the aged cell (\"rise\") have no capacity to be judged over.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwise.cell.model_error import in_bands
from cellwise.cell.simulate import known_temperature_C, simulate
from cellwise.estimate.estimators import make_estimator
from cellwise.fit.model_error import polarisation_of
from cellwise.identify import CellTests, IdentifySettings
from cellwise.logs import read_log
from measured_models import AT_ITS_BOUND, identify_once, missed, rmse

REFERENCE_AH = 2.9973  # C/20 at 25 degC
# Below 0 degC the cell had aged by an unknown part.
REFERENCES_AH = {"n10": (2.8, 2.9, 2.9973), "n20": (2.8, 2.9, 2.9973)}
FITTED = ("cycle_2", "cycle_4", "us06")
CHAMBER_C = {"p25": 25.0, "p10": 10.0, "p00": 0.0, "n10": -10.0, "n20": -20.0}
JUDGED = {
    "p25": ("hwfta", "hwftb", "nn", "cycle_3"),
    # LA92 at 10 degC has a gap of 63 hours, over which nobody counted.
    "p10": ("hwfet", "nn", "cycle_1", "cycle_3"),
    **dict.fromkeys(("p00", "n10", "n20"), ("hwfet", "la92", "udds", "nn", "cycle_1", "cycle_3")),
}
KNOWN_STD = 0.005
MORE = 0.003  # of SOC RMSE, a filter may lose against counting
HARDLY = 0.002
FILTERS = ("ekf", "ukf", "adaptive")
# RMSE after the first quarter, mean of all drives and starts.
MIDDLE = {"p25": 0.005, "p10": 0.010, "p00": 0.018, "n10": 0.035, "n20": 0.050}

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def nca(real_data):
    """The model, and the drives not in its fit by temperature."""
    folder = real_data / "panasonic_18650pf"

    def log(tag, name):
        return replace(read_log(folder / f"drive_{tag}_{name}.csv.gz"), soc0=1.0)

    tests = CellTests(
        hppc=tuple((read_log(folder / f"hppc_{t}.csv.gz"), c) for t, c in CHAMBER_C.items()),
        ocv=(read_log(folder / "ocv_c20_p25.csv.gz"),),
        drive=tuple((log(t, name), c) for t, c in CHAMBER_C.items() for name in FITTED),
    )
    model = identify_once(tests, IdentifySettings(nominal_Ah=2.9)).model
    return model, {t: [log(t, name) for name in names] for t, names in JUDGED.items()}


def truth_of(log):
    return 1.0 - (log.charge_Ah - log.charge_Ah[0]) / REFERENCE_AH


def from_known(model, logs, name):
    """SOC RMSE from a start that is known, log by log."""
    found = [make_estimator(name, model).run(log, 1.0, KNOWN_STD).soc for log in logs]
    return np.array([rmse(soc - truth_of(log)) for soc, log in zip(found, logs, strict=True)])


@pytest.mark.parametrize("name", ["ekf", "ukf"])
@pytest.mark.parametrize("tag", CHAMBER_C)
def test_from_a_known_start(nca, tag, name):
    model, drives = nca
    counted = from_known(model, drives[tag], "coulomb")
    assert np.max(from_known(model, drives[tag], name) - counted) < MORE


@pytest.mark.parametrize("tag", CHAMBER_C)
def test_adaptive_is_hardly_worse_than_the_ekf(nca, tag):
    model, drives = nca
    ekf = from_known(model, drives[tag], "ekf")
    assert np.max(from_known(model, drives[tag], "adaptive") - ekf) < HARDLY


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("tag", missed(CHAMBER_C, n20="11.5 %"))
def test_from_a_wrong_start_it_is_clearly_better_than_counting(nca, tag, name):
    """A filter that ignores the voltage stays 30 points off."""
    model, drives = nca
    for log in drives[tag]:
        assert rmse(make_estimator(name, model).run(log, 0.7, 0.15).soc - truth_of(log)) < 0.10


@pytest.mark.parametrize("tag", CHAMBER_C)
def test_an_offset_of_3_per_cent_of_1c_is_not_counted_by_the_adaptive_filter(nca, tag):
    model, drives = nca
    logs = [replace(log, current_A=log.current_A + 0.03 * 2.9) for log in drives[tag]]
    ours, counted = (np.mean(from_known(model, logs, n)) for n in ("adaptive", "coulomb"))
    assert ours < 0.5 * counted


FOLLOWED = {f"{tag} {name}": (tag, name) for tag in CHAMBER_C for name in ("ekf", "ukf")}


@pytest.mark.parametrize(
    "case",
    missed(
        FOLLOWED,
        **{
            "n10 ekf": "1.06 times counting in one drive",
            "n10 ukf": f"about as counting in one drive: {AT_ITS_BOUND}",
        },
    ),
)
def test_an_offset_of_3_per_cent_of_1c_is_followed_from_a_known_start(nca, case):
    """Either sign: no drive worse than counting, at most 0.6 times its error in the mean."""
    tag, name = FOLLOWED[case]
    model, drives = nca
    ours, counted = [], []
    for sign in (1.0, -1.0):
        logs = [replace(g, current_A=g.current_A + sign * 0.03 * 2.9) for g in drives[tag]]
        ours.append(from_known(model, logs, name))
        counted.append(from_known(model, logs, "coulomb"))
    ratios = np.divide(ours, counted)
    assert np.max(ratios) < 1.0
    assert np.mean(ours) < 0.6 * np.mean(counted)


@pytest.mark.parametrize("name", ["ekf", "ukf"])
@pytest.mark.parametrize(
    "tag",
    missed(
        CHAMBER_C,
        p00="90 % of the rows (held before the one fit)",
        n10="77 % of the rows (held before the one fit)",
        n20="85 % of the rows",
    ),
)
def test_from_a_known_start_the_band_holds_an_offset_of_3_per_cent_of_1c(nca, tag, name):
    """A start that is known and a current that is wrong: the voltages contradict the count."""
    model, drives = nca
    inside = []
    for log in drives[tag]:
        for offset_A in (0.03 * 2.9, -0.03 * 2.9):
            off = replace(log, current_A=log.current_A + offset_A)
            trace = make_estimator(name, model).run(off, 1.0, KNOWN_STD)
            inside.append(np.mean(np.abs(trace.soc - truth_of(log)) < 2.0 * trace.soc_std))
    assert np.mean(inside) > 0.93


def cut(log, at_soc):
    """The log from where it has discharged to a SOC, at its next row above 1 A; its first row."""
    begin = int(np.argmax(truth_of(log) < at_soc))
    begin += int(np.argmax(log.current_A[begin:] > 1.0))
    return log.part(begin, len(log)), begin


def from_the_middle(model, log, tag, name, at_soc, wrong):
    """RMSE after the first quarter, share inside two sigma, mean sigma; the better reference."""
    part, begin = cut(log, at_soc)
    trace = make_estimator(name, model).run(part, float(truth_of(log)[begin]) + wrong, 0.15)
    charge_Ah = (log.charge_Ah - log.charge_Ah[0])[begin:]
    late = slice(len(part) // 4, None)
    errors = [trace.soc - (1.0 - charge_Ah / q) for q in REFERENCES_AH.get(tag, (REFERENCE_AH,))]
    error = min(errors, key=lambda e: rmse(e[late]))
    inside = float(np.mean(np.abs(error) < 2.0 * trace.soc_std))
    return rmse(error[late]), inside, float(np.mean(trace.soc_std[late]))


@pytest.fixture(scope="module")
def middle(nca):
    """Means over drives and starts, by temperature and filter: RMSE, share inside, sigma."""
    model, drives = nca
    starts = ((0.65, -0.3), (0.5, 0.3))
    known = {}

    def one(tag, name):
        if (tag, name) not in known:
            runs = [
                from_the_middle(model, log, tag, name, at_soc, wrong)
                for log in drives[tag]
                for at_soc, wrong in starts
            ]
            known[tag, name] = np.mean(runs, axis=0)
        return known[tag, name]

    return one


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("tag", CHAMBER_C)
def test_cut_in_the_middle_and_30_points_wrong(middle, tag, name):
    assert middle(tag, name)[0] < MIDDLE[tag]


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("tag", CHAMBER_C)
def test_the_band_holds_the_truth(middle, tag, name):
    assert middle(tag, name)[1] > 0.93


@pytest.mark.parametrize(
    "tag",
    missed(
        CHAMBER_C,
        p25=f"2.04 times: {AT_ITS_BOUND}",
        p10="2.4 times",
        p00="2.35 times (held before the one fit)",
        n10="2.3 times",
        n20="2.1 times",
    ),
)
def test_the_band_is_no_wider_than_twice_the_error(middle, tag):
    error, _, band = middle(tag, "ekf")
    assert band < 2.0 * error


@pytest.fixture(scope="module")
def bands(nca):
    """Mean squares by time scale above 15 % SOC, stated and measured, of every drive by tag."""
    model, drives = nca
    found = {}
    for tag, logs in drives.items():
        for log in logs:
            simulation = simulate(model, log, 1.0)
            known = np.isfinite(simulation.residual_V) & (simulation.soc >= 0.0)
            warm = known_temperature_C(model, log)[known]
            soc = simulation.soc[known]
            drop = polarisation_of(model, soc, warm, simulation.voltage_V[known])
            measured = in_bands(log.time_s[known], simulation.residual_V[known]) ** 2
            stated = stated_V2(model, soc, drop, warm)
            rows = soc > 0.15
            each = [x[:, rows].mean(axis=1) for x in (stated, measured)]
            found.setdefault(tag, []).append(each)
    return found


def stated_over_measured(each):
    stated, measured = np.mean(each, axis=0)
    return np.sqrt(stated / measured)


def test_the_stated_error_is_the_measured_one_in_every_band(bands):
    """Drives that took no part, of all temperatures together."""
    ratio = stated_over_measured([one for each in bands.values() for one in each])
    assert np.all((ratio > 0.7) & (ratio < 1.4)), ratio


@pytest.mark.parametrize(
    "tag",
    missed(
        CHAMBER_C,
        p25="1.8 in the slowest band: the final model is better than those of the left-out drives",
        p10=f"1.45: {AT_ITS_BOUND}",
        p00="1.8 in the slowest band",
        n20="0.66 in the band of 100 s",
    ),
)
def test_so_it_is_at_each_temperature(bands, tag):
    ratio = stated_over_measured(bands[tag])
    assert np.all((ratio > 0.7) & (ratio < 1.4)), ratio


def stated_V2(model, soc, polarisation_V, warm_C):
    """The variance that a model states in each band, shape (scales, rows)."""
    error = model.error
    found = []
    for k in range(len(error.scales_s)):
        share = np.where(polarisation_V >= 0.0, error.shares()[k], error.shares(-1.0)[k])
        size2 = error.variance_V2(k, soc, float(np.median(warm_C)))
        found.append(size2 + (share * polarisation_V) ** 2)
    return np.array(found)
