"""These tests take few steps each: the kernels run as plain Python and are not compiled.

Undecorated they give the same bytes (tests/test_pipeline_state.py).
"""

import sys
from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module", autouse=True)
def undecorated() -> Iterator[None]:
    """All kernels of the package as plain Python."""
    with pytest.MonkeyPatch.context() as patch:
        for name, module in list(sys.modules.items()):
            if name.startswith("ahrs_service."):
                for attribute, value in list(vars(module).items()):
                    if hasattr(value, "py_func"):
                        patch.setattr(module, attribute, value.py_func)
        yield
