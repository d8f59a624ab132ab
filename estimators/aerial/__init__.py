"""Estimators for aerial images of traffic (Kozempel 2012)."""
