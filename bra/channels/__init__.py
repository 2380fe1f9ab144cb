"""Channels: conditional distributions between two spaces."""

from bra.channels.base import Channel
from bra.channels.cnn import CNN
from bra.channels.gaussian import Gaussian
from bra.channels.mlp import MLP
from bra.channels.multinomial import Multinomial
from bra.channels.table import Table

__all__ = ["CNN", "MLP", "Channel", "Gaussian", "Multinomial", "Table"]
