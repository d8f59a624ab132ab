"""Which pairs of tracks keep their distance: groups that may belong to one rigid body, before any motion is known.

The distance of two points of a rigid body is the same in all frames, whatever the motion and the datum. The graph of
the pairs for which it is, within their accuracy, holds every rigid group as a dense cluster (pairwise consistency:
Mangelson et al. 2018, Lusk et al. 2021). It needs no start values, and half the tracks and more may be wrong.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

from estimators.stereo.object_motion import Problem

Array = np.ndarray
# A pair is dropped at this error probability: low, for a good track has many pairs and later tests decide.
_LEVEL = 1e-3


def consistency(problem: Problem, C: Float[Array, "k 3 3"]) -> tuple[Bool[Array, "n n"], Bool[Array, "n n"]]:
    """Pairs that keep their distance, and pairs of which that can be told (two common frames or more)."""
    m, n = problem.m, problem.n
    x, C_x, seen = np.zeros((n, m, 3)), np.zeros((n, m, 3, 3)), np.zeros((n, m), bool)
    at = (problem.point, problem.frame)
    x[at], C_x[at], seen[at] = problem.l, C, True
    both = np.zeros((m, n, n))
    length, weight = np.zeros((m, n, n)), np.zeros((m, n, n))
    for t in range(m):
        d = x[:, None, t] - x[None, :, t]
        squared = np.einsum("ija,ija->ij", d, d)
        along = np.einsum("ija,iab->ijb", d, C_x[:, t])
        one = np.einsum("ijb,ijb->ij", along, d)
        variance = one + one.T
        both[t] = np.outer(seen[:, t], seen[:, t]) & (variance > 0)
        length[t] = np.sqrt(squared)
        weight[t] = both[t] * squared / np.where(variance > 0, variance, 1.0)
    total = weight.sum(axis=0)
    mean = (weight * length).sum(axis=0) / np.where(total > 0, total, 1.0)
    T = (weight * (length - mean) ** 2).sum(axis=0)
    count = both.sum(axis=0)
    known = (count >= 2) & (total > 0)
    np.fill_diagonal(known, False)
    limit = chi2.isf(_LEVEL, np.maximum(count - 1, 1))
    return known & (limit > T), known


def largest_group(
    agree: Bool[Array, "n n"], known: Bool[Array, "n n"], among: Bool[Array, "n"], agreement: float = 0.9
) -> Bool[Array, "n"]:
    """Tracks of the densest cluster, greedily in the order of the leading eigenvector of the graph.

    agreement: share of the group a track must keep its distance to.
    """
    index = np.flatnonzero(among)
    group = np.zeros(len(among), bool)
    if len(index) < 2:
        return group
    _, vectors = np.linalg.eigh(agree[np.ix_(index, index)].astype(float))
    members: list[int] = []
    for i in index[np.argsort(-np.abs(vectors[:, -1]), kind="stable")].tolist():
        told = np.count_nonzero(known[i, members])
        if not members or (told and np.count_nonzero(agree[i, members]) >= agreement * told):
            members.append(i)
    group[members] = True
    return group
