"""A simulator before and after its repair."""

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from buggy_rl.viz.style import COLOURS, tidy

HORIZONS = ("0.3s", "1s", "3s")
PANELS = {  # quantity of a table's row -> unit
    "position": "position error [m]",
    "yaw": "heading error [rad]",
    "yaw_rate": "yaw rate error, rms [rad/s]",
}


def repair_figure(rows: Sequence[Mapping[str, float | str]]) -> Figure:
    """Errors after 0.3, 1 and 3 s of each simulator, side by side."""
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    axes = figure.subplots(1, len(PANELS))
    width = 0.8 / len(rows)
    for axis, (quantity, label) in zip(axes, PANELS.items(), strict=True):
        for index, row in enumerate(rows):
            places = [at + (index - (len(rows) - 1) / 2) * width for at in range(len(HORIZONS))]
            values = [float(row[f"{quantity}_{horizon}"]) for horizon in HORIZONS]
            axis.bar(places, values, 0.9 * width, color=COLOURS[index], label=row["simulator"])
        axis.set_xticks(range(len(HORIZONS)), [h.replace("s", " s") for h in HORIZONS])
        axis.set(xlabel="time since the start", ylabel=label)
        tidy(axis)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False
    )
    return figure
