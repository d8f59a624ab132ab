"""How wrong each estimator was: truth and estimate to error table, metrics, figures and one HTML report.

windows       one window against the truth: gauge-free motion, its covariance at the reference point
consistency   NEES with chi-square band, Cramer-Rao bound
errors        the tidy error table, one row per scalar error
evaluation    everything known of one run of one estimator
bootstrap     confidence intervals of correlated errors
metrics       registry of statistics, pooled into metrics.csv
figures       tables and estimates to matplotlib figures, no I/O
run           a run folder: its parts read, its tables and figures written
html          a run folder to one self-contained report
"""
