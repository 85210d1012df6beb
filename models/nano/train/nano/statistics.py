"""Intervals for shares."""

from __future__ import annotations

import math

import numpy as np

#: Two-sided 95 % point of the normal distribution.
Z95 = 1.959963984540054


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    if count == 0:
        return 0.0, 1.0
    share = hits / count
    centre = share + Z95**2 / (2 * count)
    spread = Z95 * math.sqrt(share * (1 - share) / count + Z95**2 / (4 * count**2))
    scale = 1 + Z95**2 / count
    return max(0.0, (centre - spread) / scale), min(1.0, (centre + spread) / scale)


def by_groups(hits: np.ndarray, groups: np.ndarray, draws: int = 1000, seed: int = 1) -> tuple[float, float]:
    """95 % bootstrap interval of the mean over groups (drives): states of one drive are not independent."""
    _, index = np.unique(groups, return_inverse=True)
    sums = np.bincount(index, weights=hits)
    counts = np.bincount(index)
    picks = np.random.default_rng(seed).integers(0, len(sums), (draws, len(sums)))
    means = sums[picks].sum(1) / counts[picks].sum(1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)
