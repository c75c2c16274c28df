"""What developers run for the speed and accuracy of cellwise itself.

``python -m benchmarks.speed``, ``accuracy``, ``firmware``, ``ablation``, ``physics_laboratory``,
``real_findings``, ``logs_to_firmware``, ``live_latency``. Benchmarks that a user runs over suites
of estimators and logs are the package :mod:`cellwise.benchmark`; studies of the papers and of the
choice of capacity are :mod:`cellwise.studies`.

One BLAS thread, set here because it must be set before NumPy is first imported: with as many
threads as cores, small matrices lose more on waking threads than they gain, and neighbours on the
machine make it random.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
