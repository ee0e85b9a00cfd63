"""Time against drive length and against the number of candidates, as a picture."""

from collections.abc import Iterable

from diagnosing.job import Row
from diagnosing.tables import medians

ROOM = 1.08  # of the largest value, so that its dot is whole


def draw(rows: Iterable[Row], file: str) -> None:
    """Writes a PNG with one curve a panel, as far as there are rows."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    found = [row for row in medians(rows) if "failed" not in row]
    panels = {
        "length": ("both drives together [s]", "total_seconds"),
        "candidates": ("effects to choose from", "candidates"),
    }
    figure, axes = plt.subplots(1, 2, figsize=(7, 2.6), sharey=True, layout="constrained")
    for axis, (kind, (label, key)) in zip(axes, panels.items(), strict=True):
        points = sorted((row[key], row["seconds"]) for row in found if row["kind"] == kind)
        axis.plot([x for x, _ in points], [y for _, y in points], "o-", color="tab:blue")
        axis.set_xlabel(label)
        axis.set_xlim(0, ROOM * max((x for x, _ in points), default=1.0))
        axis.grid(alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("time of a diagnosis [s]")
    axes[0].set_ylim(0, ROOM * max((row["seconds"] for row in found), default=1.0))
    figure.savefig(file, dpi=150)
    plt.close(figure)
