import pytest


@pytest.fixture(scope="session")
def reproduced():
    """The paper on two rigs; who asks for it is of the group `paper`, so that it is made once."""
    from inteco_abs.paper import reproduce

    return reproduce(2)
