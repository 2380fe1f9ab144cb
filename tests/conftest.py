import functools

import jsonargparse
import pytest
import torch

torch.set_num_threads(1)

# Every parser of the command asks for the same class, and looks for its name in all that calls it,
# which is a lot below pytest.
jsonargparse.class_from_function = functools.cache(jsonargparse.class_from_function)


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory):
    """Compiled code of the tests is made in the tests, and gone after them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield
