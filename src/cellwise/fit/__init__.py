"""The one fit of a model to logs: unknowns, residual, likelihood, solution, posterior.

``solve.fit_logs`` is the fit. What it is made of, in the order of reading:

- ``unknowns``: one vector theta, and ``Layout``, which says where in it the curves (coefficients of
  ``splines`` over SOC), the scalars and what is each log's own stand;
- ``population``: the prior, theta ~ N(mean, 1 / precision), by cells that were measured;
- ``rows``: a log made ready, ``PreparedLog``: few rows that are compared with the model;
- ``sensitivity_kernels``: voltage of those rows and its derivative by theta, in one pass;
- ``problem``: minus log posterior of theta, with gradient and Gauss-Newton matrix (``Normal``);
- ``solver``: its minimum within the bounds, and the covariance there (Laplace).

A fit is solved in passes; after each the sizes of the errors are found again from the residuals.
On top: ``log_starts`` (where a log may begin), ``capacity`` (profile likelihood), ``posterior``
(what goes with the model), ``model_error`` (from loads left out). Equations: docs/theory.md,
section 8.
"""
