"""Notebooks of optional extras are left out where these are not installed."""

import importlib.util

collect_ignore = []
if importlib.util.find_spec("blackjax") is None:
    collect_ignore.append("posterior.ipynb")
