"""The matrix notices what is wrong: a mutant of the reference fails a check, unless it computes the same."""

import importlib
import pkgutil
import sys
from collections.abc import Iterator
from functools import cache
from types import ModuleType
from typing import Any

import checks
import mutants
import numpy as np
import pytest
import test_energy
from test_energy import ENERGY_CASES
from test_matrix import CELLS, INPUTS
from without_truth import CHECKS, Check

from lfgpu._backends import load
from lfgpu.kernels import reference

pytestmark = pytest.mark.thorough

REFERENCE = load("reference")
ROOM = 250_000  # elements of the inputs: larger cases are about blocks of threads
MODULES = [module.name for module in pkgutil.iter_modules(reference.__path__) if module.name != "backend"]
SAME = {
    **{"alignment": 2, "boundaries": 4, "confidence": 1, "conjugate": 1, "cost_volume": 2, "lbfgs": 13, "nlm": 3},
    **{"nlm_regression": 1, "occlusion": 1, "range_search": 5, "resampling": 1, "residuals": 4, "semi_global": 2},
    **{
        "smoothing": 7,
        "structure_tensor": 2,
        "vector": 2,
        "motion": 6,
        "streaming": 8,
        "sectors": 1,
        "convolution": 1,
        "measuring": 1,
        "facets": 2,
    },
}
"""By module, how many mutants compute the same: values that are overwritten before they are read, slices that end
behind the last element, numbers beside a division that is not taken, limits that nothing comes near, signs of what
only its size counts of, more zeros than are read."""


def module_of(name: str) -> ModuleType:
    return importlib.import_module(f"{reference.__name__}.{name}")


def used(module: ModuleType) -> set[str]:
    """The modules of the reference that a module takes something from, and itself."""
    homes = {str(getattr(value, "__module__", "")) for value in vars(module).values()}
    others = {home for home in homes if home.startswith(f"{reference.__name__}.")} - {module.__name__}
    return {module.__name__}.union(*(used(sys.modules[home]) for home in others))


@cache
def prepared(name: str) -> tuple[checks.Operation, Any, Any, dict[str, Any]] | None:
    """Operation, case, inputs and what the reference makes of them; the same in each run. None if they are large."""
    operation, case = next(param.values for param in CELLS if param.id == name)
    inputs = INPUTS[operation.inputs][1](case, np.random.default_rng([*name.encode()]))
    if sum(values.size for values in vars(inputs).values() if isinstance(values, np.ndarray)) > ROOM:
        return None
    return operation, case, inputs, checks.compute(REFERENCE, "cpu", operation, inputs)


def cells_of(module: ModuleType) -> Iterator[tuple[checks.Operation, Any, Any, dict[str, Any]]]:
    """The cells of the matrix whose operation takes something from the module."""
    for param in CELLS:
        name = str(param.values[0])
        operation = getattr(REFERENCE, name, None) or getattr(REFERENCE.streaming, name, None)
        home = operation.__module__ if operation else f"{reference.__name__}.memory"
        if module.__name__ in used(sys.modules[home]):
            found = prepared(str(param.id))
            if found is not None:
                yield found


def noticed(mutant: mutants.Mutant, cells: list[tuple[checks.Operation, Any, Any, dict[str, Any]]]) -> bool:
    """Return True if a cell fails. The unchanged reference computes the scales of errors."""
    for operation, case, inputs, want in cells:
        try:
            with mutant.at_work(), np.errstate(all="ignore"):
                got = checks.compute(REFERENCE, "cpu", operation, inputs)
            checks.check_outputs(operation, got, want, inputs, case.tolerance)
        except Exception:
            return True
    return False


@pytest.mark.parametrize("name", [name for name in MODULES if name != "control"])
def test_every_mutant_fails_a_cell_of_the_matrix(name: str) -> None:
    module = module_of(name)
    cells, all_of_them = list(cells_of(module)), list(mutants.mutants(module))
    assert cells
    assert all_of_them
    passed = [mutant.name for mutant in all_of_them if not noticed(mutant, cells)]
    assert len(passed) == SAME.get(name, 0), passed


ENERGIES = [
    Check(module, test_energy.check_energy, module, lambda rng: (test_energy.energy_inputs(ENERGY_CASES[0], rng), 1e-5))
    for module in ("splat", "nlm")
]
WITHOUT_TRUTH = {check.run: check for check in reversed(CHECKS) if check.module}
"""Of each check the first case."""


@pytest.mark.parametrize("check", [*WITHOUT_TRUTH.values(), *ENERGIES], ids=str)
def test_a_check_without_truth_notices_mutants(check: Check) -> None:
    check.run(REFERENCE, "cpu", *check.make(np.random.default_rng(0)))
    for mutant in mutants.mutants(module_of(check.module)):
        with mutant.at_work(), np.errstate(all="ignore"):
            try:
                check.run(REFERENCE, "cpu", *check.make(np.random.default_rng(0)))
            except AssertionError:
                return
            except Exception:  # a mutant that cannot run says nothing about the check
                continue
    pytest.fail("no mutant is noticed")
