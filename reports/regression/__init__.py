"""The regression check: the same battery measured with other code, held against baselines, a verdict per metric.

checked    which metrics are compared, per run, and the smallest difference of each that matters
verdicts   paired comparison of two tables, corrected for the number of metrics
files      baselines as CSV, verdicts as JSON and JUnit
"""
