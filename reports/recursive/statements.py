"""What the source says of filters in words, held against what a study has found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from reports.claim import Claim, holds
from reports.display import SUPERSCRIPT
from reports.recursive.method_statements import methods, tuning
from reports.recursive.precision import SOURCE_RANGE, holds_up_to, pooled
from reports.recursive.scalar import gain_table, start_table, steady_state
from reports.studies import StudyResult

_ROOTS = ("potter", "carlson", "udu")
_FIT = (1e2, 1e6)  # ranges within which single precision still has digits left to lose
_CONFIDENCE = 0.95


def claims(result: StudyResult) -> pd.DataFrame:
    """One row per statement of the source: what it says, what was found, whether it holds (yes, in part, no).

    Raises
        KeyError: the source says nothing of a study of this name.
    """
    return pd.DataFrame(_CLAIMS[result.name](result), columns=["the source says", "found here", "holds"])


def _precision(result: StudyResult) -> list[Claim]:
    alike, apart = sorted(dict.fromkeys(result.points["spread"]))
    up_to, further = holds_up_to(result, alike), holds_up_to(result, apart)
    last = int(result.metrics["bin"].astype(int).max())
    lost = pooled(result, "lost", last)
    lost = lost[(lost["spread"] == alike) & (lost["range"] == SOURCE_RANGE)].set_index("estimator")["value"]
    digits = {form: _digits_per_decade(result, form, alike) for form in result.estimators}
    state = pooled(result, "state_error", last)
    state = state[(state["spread"] == alike) & (state["range"] == SOURCE_RANGE)].set_index("estimator")["value"]
    roots, others = [up_to[f] for f in _ROOTS], [f for f in result.estimators if f not in _ROOTS]
    none_lost = float(1 - (1 - _CONFIDENCE) ** (1 / result.runs))
    return [
        (
            "very good measurements beside P*: negative eigenvalues of P",
            f"plain form: none up to {_power(up_to['plain'])}, at 10¹⁰ in {_percent(lost['plain'])} of the runs",
            holds(lost["plain"] > 0),
        ),
        (
            "even in the stabilised form",
            f"Joseph: none up to {_power(up_to['joseph'])}, at 10¹⁰ in {_percent(lost['joseph'])}",
            holds(lost["joseph"] > 0),
        ),
        (
            "large differences in the eigenvalues of P amplify that",
            f"with {_power(apart)} between the start variances the plain form holds up to "
            f"{_power(further['plain'])} in place of {_power(up_to['plain'])}: scales of single states do no harm",
            holds(bool((further < up_to).any())),
        ),
        (
            "roots: the range of the eigenvalues may be far larger, 10¹⁰ is one of 10⁵",
            "digits lost per decade of range: "
            + ", ".join(f"{form} {digits[form]:.2f}" for form in ("plain", "joseph", *_ROOTS)),
            holds(max(digits[f] for f in _ROOTS) < 0.6 and digits["plain"] > 0.9),
        ),
        (
            "root forms and U D U' are numerically stable at 10¹⁰",
            f"none of {result.runs} runs lost (with 95 % confidence below {100 * none_lost:.1f} %), "
            f"up to {_power(min(roots))} in all three; of the others at least {_percent(lost[others].min())}",
            holds(bool((lost[list(_ROOTS)] == 0).all()), min(roots) >= 1e8),
        ),
        (
            "so they cure what a limited word length does to the filter",
            f"to P, yes; x is off by {state['udu']:.0f} standard deviations after {last} steps at 10¹⁰ in U D U' too: "
            f"a state of that size has no digits left for what is known of it",
            holds(state["udu"] < 0.1, bool((lost[list(_ROOTS)] == 0).all())),
        ),
    ]


def _digits_per_decade(result: StudyResult, form: str, spread: float) -> float:
    """Slope of the error of the covariance over the range, both as logarithms, after the first step."""
    rows = pooled(result, "covariance_error", 1)
    rows = rows[(rows["spread"] == spread) & (rows["estimator"] == form) & rows["range"].between(*_FIT)]
    return float(np.polyfit(np.log10(rows["range"]), np.log10(rows["value"]), 1)[0])


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _power(value: float) -> str:
    return f"10{f'{np.log10(value):.0f}'.translate(SUPERSCRIPT)}" if value > 0 else "no range"


def _scalar(result: StudyResult) -> list[Claim]:
    gain, start = gain_table(result), start_table(result)
    off = float(np.abs(gain["gain"] / gain["gain, Riccati"] - 1).max())
    good, poor = (_nearest(gain, "gain, Riccati", k) for k in (0.95, 0.1))
    first, rms = start["first gain"], start["RMS, step 1"]
    best = _nearest(start, "P*(0) / true", 1)
    settled = start["within 10 % from step"]
    confident, cautious = start.iloc[0], start.iloc[-1]
    return [
        (
            "very good measurements: K just below 1, 0.95 (6.24)",
            f"K = {good['gain']:.3f} at Q / R = {good['Q / R']:.4g}; at most {gain['gain'].max():.3f}",
            holds(bool(np.isclose(good["gain"], 0.95, atol=1e-3)) and gain["gain"].max() < 1),
        ),
        (
            "very poor measurements: a small K, as 0.1 (6.25)",
            f"K = {poor['gain']:.3f} at Q / R = {poor['Q / R']:.3g}",
            holds(bool(np.isclose(poor["gain"], 0.1, atol=1e-3))),
        ),
        (
            "then p is improved a little only: p = 0.9 p* (6.26)",
            f"p / p* = {poor['p'] / steady_state(poor['Q / R'])[0]:.3f}",
            holds(bool(np.isclose(poor["p"] / steady_state(poor["Q / R"])[0], 0.9, atol=1e-3))),
        ),
        (
            "K follows from Q, R and P*(0) (steady state: Riccati)",
            f"all gains to {off:.0e}; the squared errors agree with p in {_agreeing(gain)} of {len(gain)} cases",
            holds(off < 1e-3 and _agreeing(gain) >= len(gain) - 1),
        ),
        (
            "the closer P*(0) is to P*(k), the better the convergence",
            f"RMS at step 5: {best['RMS, step 5']:.2f} with the true one, {confident['RMS, step 5']:.2f} with "
            f"{confident['P*(0) / true']:g}, {cautious['RMS, step 5']:.2f} with {cautious['P*(0) / true']:g} of it; "
            f"within 10 % from steps {_list(settled)}",
            holds(False, best["RMS, step 5"] <= start["RMS, step 5"].min() * 1.01),
        ),
        (
            "the larger P*(0), the more will measured values be taken into account",
            f"first gains {_list(first)}",
            holds(bool((np.diff(first) > 0).all())),
        ),
        (
            "a large P*(0) can be afforded only if R is not too large, or there may be no convergence",
            f"with P*(0) = {_power(cautious['P*(0) / true'] * 100)} R it converges from step "
            f"{cautious['within 10 % from step']:g}; the first error is R's, {rms.iloc[-1]:.2f} √R",
            holds(bool(np.isnan(cautious["within 10 % from step"]))),
        ),
    ]


def _nearest(table: pd.DataFrame, column: str, value: float) -> pd.Series:
    return table.iloc[int((table[column] - value).abs().to_numpy().argmin())]


def _agreeing(gain: pd.DataFrame) -> int:
    """In how many cases the interval of the mean squared error holds the variance of the steady state."""
    return int(gain["p, Riccati"].between(gain["RMS² from"], gain["RMS² to"]).sum())


def _list(values: pd.Series) -> str:
    return ", ".join(f"{v:.3g}" for v in values)


_CLAIMS: dict[str, Callable[[StudyResult], list[Claim]]] = {
    "dickmanns-precision": _precision,
    "dickmanns-scalar-filter": _scalar,
    "dickmanns-vehicle-filter": tuning,
    "filter-vs-adjustment": methods,
}
