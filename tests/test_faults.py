"""The faults that `tests/faults.py` injects are still places in the code."""

import faults
import pytest


@pytest.mark.parametrize("fault", faults.FAULTS, ids=lambda fault: fault.name)
def test_the_fault_can_be_injected(fault: faults.Fault) -> None:
    text = (faults.ROOT / fault.file).read_text(encoding="utf-8")
    assert text.count(fault.old) == 1
    assert fault.new not in text
    assert (faults.ROOT / fault.tests[0]).is_file()
