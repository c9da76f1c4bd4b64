"""Matplotlib figures in the style of the reports: ``plot.spectrum``, ``plot.sky``, ``plot.room``, ``plot.curve``, ``plot.plane``.

Each draws on ``ax``, or on a new figure, and returns the axes. Colours are perceptually uniform and colour-blind safe.
"""

from __future__ import annotations

from typing import Any, Optional, Tuple

import numpy as np

from ._errors import missing

# The reports' sequential scale: lightness linear in the value, hue and chroma at 0, 1/4, 1/2, 3/4 and 1 (OKLCh).
_HUES = ((305.0, 0.10), (268.0, 0.115), (205.0, 0.085), (152.0, 0.14), (106.0, 0.175))
TRAINING, TEST, RECEIVER = "#c27c00", "#00805c", "#174a99"


def _axes(ax: Any, **options: Any) -> Any:
    if ax is not None:
        return ax
    try:
        import matplotlib.pyplot as plt
    except ModuleNotFoundError:
        raise missing("matplotlib", "plot") from None

    return plt.subplots(layout="constrained", **options)[1]


def colours() -> Any:
    """Colour map of the reports, from dark violet to yellow."""
    try:
        from matplotlib.colors import ListedColormap
    except ModuleNotFoundError:
        raise missing("matplotlib", "plot") from None

    t = np.linspace(0.0, 1.0, 256)
    hue = np.deg2rad(np.interp(t, np.linspace(0, 1, 5), [h for h, _ in _HUES]))
    chroma = np.interp(t, np.linspace(0, 1, 5), [c for _, c in _HUES])
    lightness, a, b = 0.23 + 0.70 * t, chroma * np.cos(hue), chroma * np.sin(hue)
    l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3
    m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3
    s = (lightness - 0.0894841775 * a - 1.2914855480 * b) ** 3
    linear = np.stack(
        [
            4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
            -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
            -0.0041960863 * l - 0.7034186147 * m + 1.7076147010 * s,
        ],
        axis=-1,
    ).clip(0.0, 1.0)
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    return ListedColormap(shown.clip(0.0, 1.0), name="pwrfgs")


def spectrum(
    values: Any, ax: Any = None, title: Optional[str] = None, elevation_deg: Tuple[float, float] = (0.0, 90.0)
) -> Any:
    """Plot a spatial spectrum [H, W]: azimuth on x, elevation on y."""
    values = np.asarray(values)
    if values.ndim != 2:
        raise ValueError(f"values has shape {list(values.shape)}, expected [H, W]; select one spectrum")
    ax = _axes(ax, figsize=(6.4, 2.4))
    shown = ax.imshow(
        values.clip(0.0, 1.0), origin="lower", aspect="auto", cmap=colours(), vmin=0.0, vmax=1.0,
        extent=(0.0, 360.0, *elevation_deg), interpolation="nearest",
    )
    ax.set(xlabel="azimuth, degrees", ylabel="elevation, degrees", xticks=range(0, 361, 90))
    if title:
        ax.set_title(title, loc="left", fontsize="medium")
    ax.figure.colorbar(shown, ax=ax, label="amplitude", pad=0.02)
    return ax


def sky(values: Any, ax: Any = None, title: Optional[str] = None, elevation_deg: Tuple[float, float] = (0.0, 90.0)) -> Any:
    """Plot a spatial spectrum [H, W] as a sky map: zenith at the centre, horizon at the edge."""
    values = np.asarray(values)
    if values.ndim != 2:
        raise ValueError(f"values has shape {list(values.shape)}, expected [H, W]; select one spectrum")
    ax = _axes(ax, figsize=(3.6, 3.6), subplot_kw={"projection": "polar"})
    height, width = values.shape
    azimuth = np.deg2rad(np.linspace(0.0, 360.0, width + 1))
    zenith = 90.0 - np.linspace(*elevation_deg, height + 1)
    ax.pcolormesh(azimuth, zenith, values.clip(0.0, 1.0), cmap=colours(), vmin=0.0, vmax=1.0, rasterized=True)
    ax.set(ylim=(0.0, 90.0), yticks=[30, 60], yticklabels=["60°", "30°"], xticks=np.deg2rad([0, 90, 180, 270]))
    ax.set_rlabel_position(45)
    ax.grid(False)
    ax.tick_params(axis="y", labelcolor="white", labelsize="small")
    if title:
        ax.set_title(title, fontsize="medium")
    return ax


def room(dataset: Any, model: Any = None, split: Any = None, ax: Any = None) -> Any:
    """Plot the room from above, metres: surface points, receivers, transmitters (by set, if ``split`` is given) and the Gaussians
    of ``model``, with size by opacity."""
    ax = _axes(ax, figsize=(5.6, 4.8))
    points, positions = dataset.points, dataset.positions
    moving = "transmitters" if dataset.rx_pose is None else "receivers"
    if len(points):
        ax.scatter(*points[:, :2].T, s=1.5, color="0.75", linewidths=0, label="surfaces", rasterized=True)
    if split is None:
        ax.scatter(*positions[:, :2].T, s=5, color=TRAINING, linewidths=0, label=moving)
    else:
        ax.scatter(*positions[split.train][:, :2].T, s=5, color=TRAINING, linewidths=0, label="training")
        ax.scatter(*positions[split.test][:, :2].T, s=7, marker="D", color=TEST, linewidths=0, label="test")
    if model is not None:
        gaussians = model.gaussians()
        ax.scatter(
            *gaussians.means[:, :2].T, s=4 + 40 * gaussians.opacities, facecolors="none", edgecolors="0.2",
            linewidths=0.7, label="Gaussians",
        )
    at = np.array([receiver.position for receiver in dataset.receivers])
    ax.scatter(*at[:, :2].T, s=60, marker="^", color=RECEIVER, zorder=3, label="receivers" if len(at) > 1 else "receiver")
    said = "simulated" if dataset.simulated else "measured"
    ax.set(xlabel="x, metres", ylabel="y, metres", aspect="equal")
    ax.set_title(f"{dataset.title}" + ("" if said in dataset.title else f" ({said})"), loc="left", fontsize="medium")
    legend = ax.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), fontsize="small", frameon=False)
    for handle in getattr(legend, "legend_handles", ()):  # points of the room are too small to be seen there
        handle.set_sizes([max(18.0, handle.get_sizes()[0])])
    return ax


def curve(run: Any, ax: Any = None) -> Any:
    """Plot the smoothed loss and the number of Gaussians of a run over steps."""
    ax = _axes(ax, figsize=(6.4, 3.0))
    rows = run.curve
    steps, loss = rows["step"], rows["loss"]
    width = max(1, len(loss) // 100)
    smooth = np.convolve(loss, np.ones(width) / width, mode="valid")
    ax.plot(steps[width - 1 :], smooth, color=RECEIVER, label="loss")
    ax.set(xlabel="step", ylabel="loss", yscale="log")
    other = ax.twinx()
    other.plot(steps, rows["gaussians"], color=TRAINING, linestyle="--", label="Gaussians")
    other.set(ylabel="Gaussians", ylim=(0, None))
    lines = [*ax.get_lines(), *other.get_lines()]
    ax.legend(lines, [line.get_label() for line in lines], loc="upper right", fontsize="small")
    return ax


def plane(
    values: Any,
    x: Any,
    y: Any,
    ax: Any = None,
    label: str = "received power, dBm",
    title: Optional[str] = None,
    limits: Optional[Tuple[float, float]] = None,
) -> Any:
    """Plot values [len(y), len(x)] over a horizontal plane, such as a radio map; ``x`` and ``y`` in metres. ``limits`` is the
    range of the colour scale."""
    ax = _axes(ax, figsize=(5.6, 4.4))
    shown = ax.pcolormesh(np.asarray(x), np.asarray(y), np.asarray(values), cmap=colours(), shading="nearest", rasterized=True)
    if limits is not None:
        shown.set_clim(*limits)
    ax.set(xlabel="x, metres", ylabel="y, metres", aspect="equal")
    if title:
        ax.set_title(title, loc="left", fontsize="medium")
    ax.figure.colorbar(shown, cax=ax.inset_axes((1.03, 0.0, 0.04, 1.0)), label=label)
    return ax


def radio_map(result: Any, layer: str, ax: Any = None) -> Any:
    """Plot a layer of a ``RadioMap``; azimuths have cyclic colours, extrapolations are hatched."""
    values, unit = result[layer], result.units[layer]
    ax = plane(values, result.x, result.y, ax, f"{layer}, {unit}" if unit else layer, f"{result.words[layer]}, {result.plane}")
    ax.set(xlabel=f"{result.axes[0]}, metres", ylabel=f"{result.axes[1]}, metres")
    if layer.startswith("azimuth"):
        ax.collections[0].set(cmap="twilight", clim=(0.0, 360.0))
    if result.extrapolated is not None and result.extrapolated.any():
        ax.contourf(result.x, result.y, result.extrapolated, levels=[0.5, 1.5], colors="none", hatches=["///"])
    return ax


def _map(ax: Any) -> Any:
    """Axes of a map from above."""
    ax = _axes(ax, figsize=(5.0, 4.4))
    ax.set(xlabel="x, metres", ylabel="y, metres", aspect="equal")
    ax.margins(0.1)
    return ax


def located(result: Any, ax: Any = None) -> Any:
    """Plot the estimates of ``Model.locate`` from above: lines lead to the true positions, outlines are regions."""
    ax = _map(ax)
    for outlines in result.outlines if len(result.outlines) <= 8 else ():
        for outline in outlines:
            ax.plot(*np.asarray([*outline, outline[0]]).T, color="0.4", linewidth=0.9)
    if result.truth is not None:
        for estimate, truth in zip(result.positions, result.truth):
            ax.plot(*np.stack([estimate, truth])[:, :2].T, color="0.6", linewidth=0.7, zorder=1)
        ax.scatter(*result.truth[:, :2].T, s=12, marker="D", color=TEST, linewidths=0, label="true position")
    ax.scatter(*result.positions[:, :2].T, s=14, color=TRAINING, linewidths=0, label="estimate")
    ax.legend(fontsize="small", frameon=False, loc="center left", bbox_to_anchor=(1.02, 0.5))
    return ax


def plan(result: Any, ax: Any = None) -> Any:
    """Plot the positions of a ``Plan`` from above, numbered in their order."""
    ax = _map(ax)
    ax.scatter(*result.positions[:, :2].T, s=20, color=RECEIVER, linewidths=0)
    for number, position in enumerate(result.positions[:30], 1):
        ax.annotate(str(number), position[:2], xytext=(3, 3), textcoords="offset points", fontsize="small")
    return ax


def placement(result: Any, ax: Any = None) -> Any:
    """Plot the receivers of all choices of a ``Placement`` from above."""
    ax = _map(ax)
    for (name, (_, positions, coverage)), colour, marker in zip(result.choices.items(), (RECEIVER, TRAINING, TEST), "^sD"):
        ax.scatter(*positions[:, :2].T, s=50, marker=marker, color=colour, label=f"{name}: {coverage:.1f} dBm")
    ax.legend(fontsize="small", frameon=False, loc="center left", bbox_to_anchor=(1.02, 0.5))
    return ax


def comparison(result: Any, ax: Any = None) -> Any:
    """Plot the main metric of each method and baseline of a ``Comparison``; lines are standard deviations over seeds."""
    first = result.rows[0]
    same = ("setting", "metric", "statistic")
    rows = [row for row in result.rows if all(row[name] == first[name] for name in same)]
    ax = _axes(ax, figsize=(5.6, 0.8 + 0.3 * len(rows)))
    for place, row in enumerate(rows):
        colour = RECEIVER if row["kind"] == "variant" else TRAINING
        ax.errorbar(row["value"], place, xerr=np.nan_to_num(row["std"]), fmt="o", color=colour)
    unit = f", {first['unit']}" if first["unit"] else ""
    ax.set(xlabel=f"{first['metric']}, {first['statistic']}{unit}", yticks=range(len(rows)))
    ax.set_yticklabels([row["variant"] for row in rows])
    ax.invert_yaxis()
    ax.set_title(first["setting"], loc="left", fontsize="medium")
    return ax
