"""Studies on embedded data: the two papers' tables, the capacity study, the demo.

A study answers one question once, with a text or a page. What compares estimators over many logs
and faults is a benchmark (:mod:`cellwise.benchmark`); what measures the speed and accuracy of
cellwise itself is in ``benchmarks/`` of the repository.
"""
