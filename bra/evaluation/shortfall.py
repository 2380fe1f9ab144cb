"""Means over sampled signals, and what entropies of such means fall short by.

The entropy of an estimated distribution p̂ falls short, in expectation, of the entropy of the true
one by ½ Σ_y Var[p̂(y)] / p(y) + O(N⁻²) (second-order Taylor expansion of the entropy). Var[p̂(y)] is
estimated from the spread of the rows that p̂ is a mean of.
"""

import torch
from torch import Tensor


class StratifiedSample:
    """Signals ξ_i in G groups of known mass, such as the signals of each world-state.

    A group without signals is left out, and its mass spread over the others.

    Args:
        group: g_i, the group of each signal, (N,).
        mass: m_g, (G,), summing to one.

    Attributes:
        mass: m_g, (G,), zero for groups without signals.
        weights: m_g / n_g of each signal, (N,), where its group has n_g signals.
    """

    def __init__(self, group: Tensor, mass: Tensor) -> None:
        counts = torch.bincount(group, minlength=len(mass))
        self._group = group
        self._counts = counts.clamp_min(1).double().unsqueeze(-1)
        present = torch.where(counts > 0, mass, 0.0)
        self.mass = present / present.sum()
        self.weights = (self.mass / self._counts.squeeze(-1))[group]

    def means(self, rows: Tensor) -> Tensor:
        """Mean row of every group: (N, Y) to (G, Y); zeros for groups without signals."""
        return self._sums(rows) / self._counts

    def of_signals(self, rows: Tensor) -> Tensor:
        """The mean row of each signal's group: (N, Y) to (N, Y)."""
        return self.means(rows)[self._group]

    def variance(self, values: Tensor) -> Tensor:
        """Of Σ_g m_g (mean of group g) for values (N,) of the signals: Σ_g m_g² s²_g/n_g."""
        return (self.mass.square() @ self._spread(values.unsqueeze(-1))).sum()

    def shortfall(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """What entropies of means of p(y|ξ_i) fall short by, to first order.

        Args:
            rows: p(y|ξ_i), (N, Y).

        Returns:
            ½ Σ_y V(y)/p̂(y) with V(y) = Σ_g m_g² s²_g(y)/n_g, for the entropy of the overall mean
            p̂(y) = Σ_g m_g p̂_g(y); and Σ_g m_g ½ Σ_y s²_g(y)/(n_g p̂_g(y)) for the mean entropy of
            the groups. s²_g is the sample variance within a group, 0 for one signal.
        """
        means = self.means(rows)
        variances = self._spread(rows)
        overall = _ratio(self.mass.square() @ variances, self.mass @ means).sum()
        within = self.mass @ _ratio(variances, means).sum(-1)
        return overall / 2, within / 2

    def _spread(self, rows: Tensor) -> Tensor:
        """s²_g/n_g, the variance of the mean of each group, (G, Y); 0 for one signal."""
        squares = self._sums((rows - self.of_signals(rows)).square())
        return squares / (self._counts - 1).clamp_min(1) / self._counts

    def _sums(self, rows: Tensor) -> Tensor:
        return rows.new_zeros(len(self.mass), rows.shape[1]).index_add_(0, self._group, rows)


def _ratio(variance: Tensor, mean: Tensor) -> Tensor:
    """Returns variance / mean, 0 for outcomes without mass."""
    return torch.where(mean > 0, variance / mean, 0.0)
