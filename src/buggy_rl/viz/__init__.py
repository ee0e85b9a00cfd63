"""Pictures: what was driven, what simulators make of it, and what policies learned."""

from buggy_rl.viz.drives import histogram_figure
from buggy_rl.viz.learning import learning_figure
from buggy_rl.viz.paths import paths_figure
from buggy_rl.viz.policies import policies_figure
from buggy_rl.viz.rollouts import rollout_figure
from buggy_rl.viz.tables import table_figure

__all__ = [
    "histogram_figure",
    "learning_figure",
    "paths_figure",
    "policies_figure",
    "rollout_figure",
    "table_figure",
]
