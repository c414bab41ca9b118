"""Figures: one style, one function per kind of picture; plain arrays in, a matplotlib ``Figure`` out.

No pyplot, no display, no global state: figures are drawn by Agg or written as SVG by `save_figure`. Colours are Okabe
and Ito's, which people with any colour vision can tell apart; every axis names its unit.
"""

from ikgrad.plots.arm import arm_frames, arm_path
from ikgrad.plots.batch import solve_summary
from ikgrad.plots.charts import comparison_bars, convergence, learning_rates
from ikgrad.plots.evaluation import evaluation_page
from ikgrad.plots.film import save_film
from ikgrad.plots.maps import workspace_map
from ikgrad.plots.motion import arm_motion, save_motion
from ikgrad.plots.page import evaluation_html, save_evaluation
from ikgrad.plots.sliders import explore
from ikgrad.plots.style import PALETTE, new_figure, save_figure, styled, to_png
from ikgrad.plots.sweep import save_sweep, swept_arm
from ikgrad.plots.tracking import closeups, curves_in_space, traces
from ikgrad.plots.training import learning_curves, performance, spread
from ikgrad.plots.workspace import workspace_errors

__all__ = [
    "PALETTE",
    "arm_frames",
    "arm_motion",
    "arm_path",
    "closeups",
    "comparison_bars",
    "convergence",
    "curves_in_space",
    "evaluation_html",
    "evaluation_page",
    "explore",
    "learning_curves",
    "learning_rates",
    "new_figure",
    "performance",
    "save_evaluation",
    "save_figure",
    "save_film",
    "save_motion",
    "save_sweep",
    "solve_summary",
    "spread",
    "styled",
    "swept_arm",
    "to_png",
    "traces",
    "workspace_errors",
    "workspace_map",
]
