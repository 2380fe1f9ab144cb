"""Many agents that are trained as one."""

from bra.agent.settings import Setting
from bra.population.population import Population

__all__ = ["Population", "Setting"]
