"""Generator of the embedded data: a physics model behind a virtual tester.

Needs numpy, pyarrow and pybamm, and imports nothing of cellwise: the data must not know the
model that is judged on them.
"""
