import functools
import gc
import os
import sys

import jsonargparse
import pytest
import torch

torch.set_num_threads(1)
# Of compiled code, what calls the kernels need not be fast; the kernels are compiled as ever.
os.environ.setdefault("AOT_INDUCTOR_COMPILE_WRAPPER_OPT_LEVEL", "O0")

# Every parser of the command asks for the same class, and looks for its name in all that calls it,
# which is a lot below pytest.
jsonargparse.class_from_function = functools.cache(jsonargparse.class_from_function)


def pytest_collection_finish():
    """What is loaded stays as it is: nobody has to look through it again and again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    if registry := sys.modules.get("lightning.fabric.utilities.registry"):
        # Every trainer looks through all packages that are installed for callbacks of theirs.
        registry.entry_points = functools.cache(registry.entry_points)


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory):
    """Compiled code of the tests is made in the tests, and gone after them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield
