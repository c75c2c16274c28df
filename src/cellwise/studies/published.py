"""What the two papers print, on their own cells: a reference for the method, not a target."""

from __future__ import annotations

from typing import NamedTuple

LFP_CELL = "ThunderSky Winston LFP040AHA, 40 Ah"
NCA_CELL = "NCR18650B, 3.4 Ah"


class PublishedCapacity(NamedTuple):
    """Discharged charge at one rate [Ah]."""

    total_Ah: float
    cc_Ah: float
    cv_Ah: float


class PublishedError(NamedTuple):
    """Voltage error on the charge-depleting cycle for one capacity; window is 5 to 180 min."""

    capacity_Ah: float
    rms_mV: float
    mean_pct: float
    mean_window_pct: float
    peak_pct: float
    peak_window_pct: float


class PublishedResidual(NamedTuple):
    """Voltage error of one characterization rate on its own HPPC current [mV]."""

    capacity_Ah: float
    rmse_mV: float
    mae_mV: float
    max_mV: float
    mean_mV: float
    std_mV: float
    ci95_mV: tuple[float, float]


LFP_CAPACITIES = {
    "C/2": PublishedCapacity(47.71, 46.30, 1.407),
    "1C": PublishedCapacity(47.71, 45.78, 1.934),
    "2C": PublishedCapacity(47.70, 45.21, 2.495),
    "3C": PublishedCapacity(47.62, 45.41, 2.212),
}

LFP_TEST_CHARGES_AH = (
    2.41, 2.21, 4.21, 4.21, 4.22, 4.23, 4.22, 4.21, 4.22,
    2.16, 2.18, 2.20, 2.21, 2.22, 2.20, 2.22, 0.92, 0.25,
)  # fmt: skip

# Coefficients of a + b s + c s^2 + d s^3, R in ohm, C in farad (equation 9).
LFP_POLYNOMIALS = {
    "R0": (3.551e-3, -6.172e-3, 8.993e-3, -4.267e-3),
    "R1": (9.601e-4, -1.154e-3, 1.611e-3, -5.716e-4),
    "R2": (6.169e-3, -2.678e-2, 4.690e-2, -2.485e-2),
    "C1": (5549.0, -1.359e4, 5.058e4, -3.397e4),
    "C2": (1.712e4, 8.510e4, -2.850e4, -4.243e4),
}

LFP_ERRORS = {
    "cc-average": PublishedError(45.7, 43.2, 0.977, 0.751, 14.9, 9.62),
    "cc-cv-average": PublishedError(47.7, 48.7, 1.07, 0.805, 14.6, 9.83),
    "hppc-total": PublishedError(50.7, 120.0, 2.44, 0.873, 22.9, 10.1),
    "nominal": PublishedError(40.0, 167.0, 2.73, 0.579, 20.4, 9.04),
}

NCA_RESIDUALS = {
    "C/20": PublishedResidual(3.327, 21.3, 12.2, 196.9, -10.2, 18.7, (-46.8, 26.4)),
    "C/5": PublishedResidual(3.375, 25.8, 16.8, 155.0, 2.1, 25.7, (-48.2, 52.5)),
    "C/3": PublishedResidual(3.290, 21.4, 14.4, 195.5, -2.0, 21.3, (-43.7, 39.7)),
}
