import math

import numpy as np
import pytest
import torch

from bra.checks.prices import check_beta, check_betas
from bra.checks.settings import check_count


@pytest.mark.parametrize("beta", [2, 2.0, np.float32(2.0), np.float64(2.0), np.int64(2)])
def test_any_real_number_is_a_price(beta):
    price = check_beta(beta, "beta")
    assert type(price) is float
    assert price == 2.0


@pytest.mark.parametrize("beta", [True, "2", None, [2.0], 0.0, -1, math.nan, math.inf])
def test_what_is_no_price(beta):
    with pytest.raises(ValueError, match=r"^beta must be positive and finite, got") as caught:
        check_beta(beta, "beta")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("betas", [2.0, [1.0, 2.0], np.ones((2, 3), np.float32), torch.tensor(4)])
def test_arrays_of_prices_keep_their_shape(betas):
    prices = check_betas(betas, "beta")
    assert prices.dtype == torch.float64
    assert prices.shape == np.shape(betas)


@pytest.mark.parametrize("count", [3, np.int64(3), np.uint8(3)])
def test_any_integer_is_a_count(count):
    assert type(check_count(count, "count")) is int


@pytest.mark.parametrize("count", [0, -1, True, np.bool_(True), 2.0, np.float64(2.0), "2", None])
def test_what_is_no_count(count):
    with pytest.raises(ValueError, match=r"^count must be a whole number of at least 1, got"):
        check_count(count, "count")
