"""What is known of sizes beforehand: priors of sensors, and of starts that one source has given."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from cellwise.diagnose.fit.least_squares import Prior
from cellwise.diagnose.fit.priors import (
    CLASS,
    GOOD,
    ln_size,
)


@pytest.mark.parametrize("name", CLASS)
@pytest.mark.parametrize("x", [0.0, 0.004, 0.03])
def test_a_sensor_keeps_its_class_or_is_one_of_the_few_that_are_wrong(name, x):
    usual, other = CLASS[name]
    wide = 0.05
    wrong = GOOD.wrong_class
    density = (1.0 - wrong) * norm.pdf(x, 0.0, usual) + wrong * norm.pdf(x, 0.0, other)
    found = ln_size({name: x}, [name], Prior({name: wide}, {}, {}, {}))
    assert found == pytest.approx(np.log(density) - norm.logpdf(x, 0.0, wide))
