"""Kalman filters in all their forms, as pure functions batched over independent runs (Dickmanns 2007, 6.4).

A `Form` carries the covariance of the state in its own way - as it is, as a root, as factors, as its inverse - and
knows how to predict and to correct it; all forms do the same in exact arithmetic. An estimator chooses one by name:

    form = FORMS["udu"]
    F = form.start(P)
    x, F = A @ x, form.predict(F, A, Q)
    c = form.correct(x, F, H, z - h(x), R, gate=4.0)
    x, F = c.x, c.F

`estimators.kalman.extended` has the whole recursion loop for a motion and a measurement that are not linear.

Leading axes run over independent filters; n states, m measurements. Everything stays in the precision of its input.
"""

from estimators.kalman.forms import FORMS, Form, FormName
from estimators.kalman.linear import Correction, decorrelated, variances
from estimators.kalman.smoother import Smoothed, smooth

__all__ = ["FORMS", "Correction", "Form", "FormName", "Smoothed", "decorrelated", "smooth", "variances"]
