import pytest
from slides_job import write_slides_job

import diffmill as dm

from .synthetic import corrected, simulated


@pytest.fixture(scope="session")
def simulation():
    return simulated()


@pytest.fixture(scope="session")
def correction():
    return corrected()


@pytest.fixture(scope="session")
def job(tmp_path_factory):
    """A job on three slides, of which the report takes the arm and the settings."""
    return dm.load_job(write_slides_job(tmp_path_factory.mktemp("job")))
