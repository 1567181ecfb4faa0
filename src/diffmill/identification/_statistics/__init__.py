"""Regression: robust, non-negative, nonlinear; what is identifiable."""
