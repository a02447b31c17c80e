"""Settings that every test shares; the environment must be set before numpy is first imported."""

import importlib
import logging
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")
# The suite is parallel by processes: threads inside each would only fight over the cores.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# The same examples in every run; no deadline, because the first call of a function compiles it.
settings.register_profile("bayes_sensor", derandomize=True, deadline=None)
settings.load_profile("bayes_sensor")

LOG = logging.getLogger("bayes_sensor")


@pytest.fixture(autouse=True)
def _log_as_found() -> Iterator[None]:
    """What a command did to the log is undone, or ``caplog`` of later tests would hear it twice."""
    yield
    LOG.propagate = True


STUDIES = Path(__file__).resolve().parent.parent / "paper" / "studies"


@pytest.fixture
def import_study(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Imports a study by its name, as ``run_all.py`` does."""
    monkeypatch.syspath_prepend(str(STUDIES))
    return importlib.import_module
