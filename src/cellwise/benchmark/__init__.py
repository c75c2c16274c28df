"""Benchmarks that a user runs: suites of cells, logs, estimators, faults and start errors.

One row per run, whatever the estimator: ours, or anyone's through an adapter. The studies on
embedded data are in :mod:`cellwise.studies`; what developers run for the speed and accuracy of
cellwise itself is in ``benchmarks/`` of the repository.
"""
