"""Figures of recordings, simulators and policies."""

from buggy_rl.viz.histograms import histogram_figure as histogram_figure
from buggy_rl.viz.learning import learning_figure as learning_figure
from buggy_rl.viz.paths import paths_figure as paths_figure
from buggy_rl.viz.policies import policies_figure as policies_figure
from buggy_rl.viz.rollouts import rollout_figure as rollout_figure
from buggy_rl.viz.style import save_figure as save_figure
from buggy_rl.viz.tables import table_figure as table_figure
