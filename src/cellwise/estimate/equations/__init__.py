"""The filter's equations and constants, once for every filter and for the C.

Functions of single numbers in the subset of Python that is printed as C: numbers in, a number or a
named tuple out, no record and no array. The kernels of the filters are compiled with them in
float64, the fixed step in float32 (:mod:`cellwise.estimate.fixed.stepper`), and
:mod:`cellwise.printing` prints them. What is per second for a filter is per step for the fixed
one: they take it as an argument.

The bank of components (:mod:`cellwise.estimate.equations.bank`) is the one part that works on
records: those of a component have the same fields in either precision.
"""
