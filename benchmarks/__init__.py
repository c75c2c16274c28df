"""Measured speed and accuracy: run ``python -m benchmarks.speed`` or ``benchmarks.accuracy``.

One BLAS thread, set here because it must be set before NumPy is first imported: with as many
threads as cores, small matrices lose more on waking threads than they gain, and neighbours on the
machine make it random.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
