"""What the stereo source says of filters beside its own adjustment, and the recursive one of tuning a filter."""

from __future__ import annotations

from reports.claim import Claim, holds
from reports.recursive.comparison import Aspect, aspects, difference
from reports.recursive.situations import situations
from reports.recursive.vehicle import noise_table, poor_start_table
from reports.studies import StudyResult

_FIRST_S = 0.12  # three frames, the adjustment's first window


def methods(result: StudyResult) -> list[Claim]:
    """Siegemund 2008, 1.2 and 5, on filters and the adjustment."""
    points = situations(result)

    def of(where: str, name: str) -> Aspect:
        return next(a for a in aspects(result, where, points[where]) if a.name.startswith(name))

    settling = of("constant velocity", "settling time of position")
    speed = of("constant velocity", "settling time of speed")
    poor, _, later, low, high = difference(settling, "poor filter", "filter")
    adjusted = difference(settling, "adjustment", "filter")[0]
    adjusted_speed, filtered_speed, *_ = difference(speed, "adjustment", "filter")
    rms = difference(of("constant velocity", "RMS of speed"), "filter", "adjustment")
    lag = difference(of("braking", "lag"), "filter", "adjustment")
    braking = difference(of("braking", "RMS of speed"), "filter", "adjustment")
    started = difference(of("constant velocity", "settling time of speed"), "started filter", "filter")
    first = difference(of("constant velocity", "RMS of speed"), "started filter", "filter")
    return [
        (
            "badly initialised, a filter needs some time to settle",
            f"position settles after {poor:.2f} s, {later:+.2f} s ({low:+.2f} to {high:+.2f}) beside its own start",
            holds(low > 0),
        ),
        (
            "the adjustment needs no time to settle",
            f"position after {adjusted:.2f} s; speed after {adjusted_speed:.2f} s (filter {filtered_speed:.2f} s)",
            holds(max(adjusted, adjusted_speed) <= _FIRST_S, adjusted <= _FIRST_S),
        ),
        (
            "without a model of the motion it cannot profit from one",
            f"RMS of speed {rms[0]:.2f} m/s of the filter, {rms[1]:.2f} m/s of the adjustment: "
            f"{rms[2]:+.2f} ({rms[3]:+.2f} to {rms[4]:+.2f})",
            holds(rms[4] < 0),
        ),
        (
            "nor suffer from one",
            f"braking: lag of speed {1000 * lag[0]:.0f} ms of the filter, {1000 * lag[1]:.0f} ms of the adjustment; "
            f"RMS of speed {braking[0]:.2f} and {braking[1]:.2f} m/s",
            holds(lag[3] > 0 and braking[3] > 0, lag[3] > 0),
        ),
        (
            "it is suited to start a filter",
            f"RMS of speed {first[0]:.2f} m/s, by its own start {first[1]:.2f}: {first[2]:+.2f} "
            f"({first[3]:+.2f} to {first[4]:+.2f}); speed settles after {started[0]:.2f} s, {started[1]:.2f} s",
            holds(first[4] < 0, first[3] <= 0),
        ),
    ]


def tuning(result: StudyResult) -> list[Claim]:
    """Dickmanns 2007, 6.4.4, on the vehicle filter."""
    noise, start = noise_table(result), poor_start_table(result)
    usual = noise.iloc[int((noise["√Q / default"] - 1).abs().to_numpy().argmin())]
    least, most = noise.iloc[0], noise.iloc[-1]
    best = noise.iloc[int(noise["speed, RMS [m/s]"].to_numpy().argmin())]
    speed = start["speed after 0.2 s [m/s]"]
    wide, narrow = start.iloc[-1], start.iloc[0]
    return [
        (
            "good models and noisy measurements: Q small, else the other way round",
            f"braking: RMS of speed {least['speed, RMS [m/s]']:.2f} m/s at {least['√Q / default']:g} of the noise, "
            f"{best['speed, RMS [m/s]']:.2f} at {best['√Q / default']:g}, {most['speed, RMS [m/s]']:.2f} at "
            f"{most['√Q / default']:g}",
            holds(least["√Q / default"] < best["√Q / default"] < most["√Q / default"]),
        ),
        (
            "information about Q is hard to find; change it with R fixed until the results are useful",
            f"NIS {least['NIS']:.2f}, {usual['NIS']:.2f} and {most['NIS']:.2f} at {least['√Q / default']:g}, 1 and "
            f"{most['√Q / default']:g}: it says which way",
            holds(least["NIS"] > usual["NIS"] > most["NIS"], least["NIS"] > usual["NIS"]),
        ),
        (
            "the larger P*(0), the more will measured values be taken into account",
            f"0.2 s after a poor start the speed is off by {speed.iloc[0]:.2f} m/s where P*(0) is "
            f"{narrow['P*(0) / error²']:.0e} of the squared error, {speed.iloc[-1]:.2f} m/s where it is "
            f"{wide['P*(0) / error²']:.0f} times",
            holds(bool(speed.iloc[-1] < speed.iloc[0])),
        ),
    ]
