"""The forms by their names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from estimators.kalman import dense, factored
from estimators.kalman.linear import Correction

Array = np.ndarray
FormName = Literal["plain", "joseph", "sequential", "potter", "carlson", "udu", "information"]


@dataclass(frozen=True)
class Form:
    """How a filter carries its covariance P (..., n, n), and what it does with it; F is P in the form's own way.

    start(P): F; raises ValueError where P is not positive definite.
    predict(F, A, G, q): F of A P A' + G diag(q) G', A (..., n, n), the noise of variances q (..., s) entering by G.
    correct(x, F, H, dz, R, gate): a `Correction` by measurements with Jacobian H (..., m, n), innovation dz = z - h(x)
        (..., m) and covariance R (..., k, b, b), blocks of b neighbours that are correlated, m = k b. A block is left
        out where dz is not finite, a decorrelated measurement where it is beyond its gate, dz² > gate² q with q its
        innovation covariance (6.57), in forms by scalars after those before it; raises ValueError where a block of R is
        not positive definite.
    covariance(F): P.
    """

    start: Callable[[Array], Array]
    predict: Callable[[Array, Array, Array, Array], Array]
    correct: Callable[..., Correction]
    covariance: Callable[[Array], Array]


FORMS: dict[FormName, Form] = {
    "plain": Form(dense.start, dense.predict, dense.plain, dense.covariance),
    "joseph": Form(dense.start, dense.predict_symmetric, dense.joseph, dense.covariance),
    "sequential": Form(dense.start, dense.predict_symmetric, factored.sequential, dense.covariance),
    "potter": Form(factored.start_root, factored.predict_root, factored.potter, factored.square),
    "carlson": Form(
        factored.start_transposed_root,
        factored.predict_transposed_root,
        factored.carlson,
        factored.transposed_square,
    ),
    "udu": Form(factored.start_udu, factored.predict_udu, factored.udu, factored.product),
    "information": Form(dense.start_information, dense.predict_information, dense.information, dense.inverse),
}
