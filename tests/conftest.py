"""Fixtures that all tests share."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def phantoms() -> ModuleType:
    """tests/phantoms.py; `tests` itself must not be on the import path, where it would hide the packages."""
    spec = importlib.util.spec_from_file_location("phantoms", Path(__file__).with_name("phantoms.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["phantoms"] = module
    spec.loader.exec_module(module)
    return module
