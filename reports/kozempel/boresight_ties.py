"""Boresight without control points: what three images give, by how they were flown (3.4)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from reports.figures.style import GREY, color, legend, marker, new_figure, styled
from reports.kozempel.boresight import ANGLES, LETTERS, NAVIGATION, nees_band, pooled
from reports.studies import StudyResult

START, FOUND = "start values", "adjusted"
SOURCE_GROUND_M = {"position": 5.0, "height": 1.0}
SOURCE_CONTROL_M = {"position": 1.0, "height": 0.5}
GOAL_DEG = {"omega": 0.03, "phi": 0.03, "kappa": 0.06}
"""What this bench asks of three images, started a degree off."""
LAYOUTS = {"strip": "one strip", "opposite": "there and back", "crossing": "crossing"}


def ties_table(result: StudyResult) -> pd.DataFrame:
    """Every layout and navigation: errors on the ground before and after, the angles, NEES."""
    start, found = pooled(result, START), pooled(result, FOUND)
    low, high = nees_band(result)
    table = pd.DataFrame(
        {"flown": result.points["layout"].map(LAYOUTS), "navigation": result.points["navigation"].map(NAVIGATION)}
    )
    for what in SOURCE_GROUND_M:
        table[f"{what}, 1° off [m]"] = start[f"ties_{what}"]
        table[f"{what}, adjusted [m]"] = found[f"ties_{what}"]
        table[f"{what}, source [m]"] = SOURCE_GROUND_M[what]
    for angle in ANGLES:
        table[f"{LETTERS[angle]}, RMS [°]"] = found[f"boresight_{angle}"]
        table[f"{LETTERS[angle]}, sigma [°]"] = found[f"boresight_sigma_{angle}"]
    table["NEES"], table["NEES band"] = found["boresight_nees"], f"{low:.2f} … {high:.2f}"
    table["wrong points kept [%]"] = 100 * found["ties_missed"]
    table["failed [%]"] = 100 * found["boresight_failed"]
    return table.reset_index(drop=True)


@styled
def ties_figure(result: StudyResult) -> Figure:
    """Left: errors on the ground of every run, before and after. Right: RMS and sigma of the angles."""
    figure = new_figure(3.8)
    ground, angles = figure.subplots(1, 2, width_ratios=(1.25, 1))
    m = result.measures
    layouts = list(dict.fromkeys(result.points["layout"]))
    chosen = result.points[result.points["navigation"] == "pos_av_410"]
    for i, layout in enumerate(layouts):
        point = chosen.index[chosen["layout"] == layout][0]
        rows = m[m["point"] == point]
        for case, mark in ((START, "x"), (FOUND, ".")):
            own = rows[rows["estimator"] == case].pivot_table(
                index="run", columns="quantity", values="value", observed=True
            )
            label = f"{LAYOUTS[layout]}, {'1° off' if case == START else 'adjusted'}"
            ground.plot(own["ties_position"], own["ties_height"], mark, color=color(i), ms=4, label=label)
        value, low, high = (pooled(result, FOUND, c).loc[point] for c in ("value", "ci_low", "ci_high"))
        x = np.arange(len(ANGLES)) + 0.2 * (i - 1)
        q = [f"boresight_{a}" for a in ANGLES]
        bars = np.abs(np.stack([low[q], high[q]]).astype(float) - value[q].to_numpy(float))
        angles.errorbar(x, value[q], bars, fmt=marker(i), color=color(i), ms=4, capsize=2)
        stated = value[[f"boresight_sigma_{a}" for a in ANGLES]]
        angles.plot(
            x + 0.06, stated, marker(i), mfc="white", color=color(i), ms=5, label="stated sigma" if i == 0 else ""
        )
    for name, said in (
        ("the source, without control", SOURCE_GROUND_M),
        ("the source, with control", SOURCE_CONTROL_M),
    ):
        ls = ":" if said is SOURCE_GROUND_M else "--"
        ground.plot(
            [1e-3, said["position"], said["position"]], [said["height"]] * 2 + [1e-3], ls, color=GREY, label=name
        )
    for j, angle in enumerate(ANGLES):
        angles.plot(
            [j - 0.4, j + 0.4], [GOAL_DEG[angle]] * 2, color=GREY, lw=0.9, ls="-.", label="goal" if j == 0 else ""
        )
    ground.set(xscale="log", yscale="log", xlabel="position on the ground [m]", ylabel="height [m]")
    ground.set(xlim=(0.05, 60), ylim=(0.02, 80))
    angles.set(yscale="log", ylabel="error [°]", xticks=range(len(ANGLES)), xticklabels=list(LETTERS.values()))
    legend(figure, [ground, angles])
    return figure
