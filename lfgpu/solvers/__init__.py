"""Iterative solvers. Their arguments are settings; their state is private; `report` returns a `Solution`."""
