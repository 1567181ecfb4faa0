import pytest

from .synthetic import corrected, simulated


@pytest.fixture(scope="session")
def simulation():
    return simulated()


@pytest.fixture(scope="session")
def correction():
    return corrected()
