"""Draws drag-light.webp and drag-dark.webp: a transmitter that moves through the simulated office, the Gaussians of a model,
and the predicted spectrum above the simulated one.

    pwrfgs run quickstart
    python3 docs/images/drag.py runs/quickstart [PROGRAM]

Needs NumPy, matplotlib and Pillow. PROGRAM is `pwrfgs` by default. The colours are those of the reports and colour-blind safe.
"""

import io
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402
from matplotlib.collections import EllipseCollection, LineCollection  # noqa: E402
from matplotlib.colors import LinearSegmentedColormap  # noqa: E402
from matplotlib.patheffects import withStroke  # noqa: E402

HERE = Path(__file__).resolve().parent
SCENE = HERE.parent.parent / "scenes" / "office.ron"
FRAMES, FRAME_MS = 36, 120
SIZE = (800, 400)
# Scale of the reports at 0, 1/4, 1/2, 3/4 and 1.
SCALE = LinearSegmentedColormap.from_list("pwrfgs", ["#1f1237", "#2d4f8a", "#1b9194", "#5cc467", "#f2e52b"])
THEMES = {
    "light": {"paper": "#ffffff", "ink": "#1f2328", "line": "#9aa2ab", "tx": "#d55e00", "rx": "#005aa0"},
    "dark": {"paper": "#0d1117", "ink": "#e6edf3", "line": "#59626d", "tx": "#ff9a4d", "rx": "#56b4e9"},
}


def path():
    """Closed curve through the region of the transmitters, [FRAMES, 3], metres."""
    t = 2 * np.pi * np.arange(FRAMES) / FRAMES
    return np.stack([3.9 + 1.1 * np.sin(t), 3.0 + 1.2 * np.sin(2 * t + 0.6), np.full(FRAMES, 1.2)], axis=1)


def observations(program, run, walk, folder):
    """Predicted and simulated spectra [2, FRAMES, H, W]; the Gaussians, and their weights [FRAMES, N] per position."""
    table = folder / "walk.csv"
    table.write_text("x,y,z\n" + "".join("{:.4f},{:.4f},{:.4f}\n".format(*p) for p in walk))
    call = lambda *arguments: subprocess.run([program, *map(str, arguments), "-q"], check=True, stdout=subprocess.DEVNULL)
    call("predict", run, "--tx-csv", table, "--stacked", "--no-png", "--out", folder / "predicted")
    call("simulate", SCENE, "--tx-csv", table, "--npy", "--no-paths", "--points", 10, "--out", folder / "simulated")
    spectra = [np.load(folder / name / "spectra.npy") for name in ("predicted", "simulated")]
    weights = []
    for i, (x, y, z) in enumerate(walk):
        file = folder / f"{i}.npz"
        call("export", run, "--tx", f"{x:.4f},{y:.4f},{z:.4f}", "--npz", file)
        model = dict(np.load(file))
        weights.append(model["tx.opacities"] * np.linalg.norm(model["tx.signals"], axis=1))
    return [spectra[0].clip(0, 1), spectra[1] / 255], model, np.array(weights)


def axes_of_view(azimuth_deg=-62, elevation_deg=42):
    """Right and up of an orthographic view of the room, [2, 3]."""
    (a, e) = np.radians([azimuth_deg, elevation_deg])
    right = [-np.sin(a), np.cos(a), 0]
    return np.array([right, [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)]])


VIEW = axes_of_view()


def edges_of(corners, heights):
    """Edges of a prism: its corners on the floor plan and its two heights, [E, 2, 3]."""
    low, high = [[(*corner, h) for corner in corners] for h in heights]
    n = len(corners)
    around = [(level[i], level[(i + 1) % n]) for level in (low, high) for i in range(n)]
    return around + list(zip(low, high))


def furniture():
    """Edges of the room and of its objects, two lists of [E, 2, 3]; metres."""
    numbers = lambda text: [float(v) for v in text.split(",")]
    room, objects = [], []
    for line in SCENE.read_text().splitlines():
        line = line.split("//")[0]
        box = re.search(r"Box\(.*low: \((.*?)\), high: \((.*?)\)", line)
        panel = re.search(r"Panel\(.*from: \((.*?)\), to: \((.*?)\), heights: \((.*?)\)", line)
        if box:
            (x, y, z), (u, v, w) = map(numbers, box.groups())
            corners = np.array([(x, y), (u, y), (u, v), (x, v)])
            yaw = np.radians(float((re.search(r"yaw_deg: ([\d.-]+)", line) or [0, 0])[1]))
            middle, turn = corners.mean(axis=0), np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
            edges = edges_of(middle + (corners - middle) @ turn, (z, w))
            (room if "outline" in line else objects).extend(edges)
        elif panel:
            ends = [numbers(end) for end in panel.groups()]
            objects.extend(edges_of(ends[:2], ends[2]))
    return np.array(room), np.array(objects)


def ellipses(model):
    """Centres [N, 2], and widths, heights and angles of the Gaussians in the view, half a standard deviation."""
    w, x, y, z = (model["tx.quats"] / np.linalg.norm(model["tx.quats"], axis=1, keepdims=True)).T
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    half = VIEW @ turn * model["tx.scales"][:, None, :]
    values, vectors = np.linalg.eigh(half @ half.transpose(0, 2, 1))
    width, height = np.sqrt(values[:, ::-1].T)
    return model["means"] @ VIEW.T, width, height, np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))


def draw(theme, i, walk, spectra, model, weights, scene):
    """One frame as an image."""
    figure = plt.figure(figsize=(SIZE[0] / 100, SIZE[1] / 100), dpi=100, facecolor=theme["paper"])
    ink = {"color": theme["ink"], "fontsize": 14}
    room = figure.add_axes((0.0, 0.04, 0.56, 0.89))
    for edges, width in zip(scene, (1.6, 0.9)):
        room.add_collection(LineCollection(edges @ VIEW.T, colors=theme["line"], linewidths=width))
    centres, width, height, angle = ellipses(model)
    strength = np.sqrt(weights[i] / weights.max())
    order = np.argsort(strength)
    colours = SCALE(strength[order])
    colours[:, 3] = 0.15 + 0.75 * strength[order]
    room.add_collection(
        EllipseCollection(
            width[order], height[order], angle[order], units="xy", offsets=centres[order],
            offset_transform=room.transData, facecolors=colours, linewidths=0,
        )
    )
    trail = walk[np.arange(i - 8, i + 1)] @ VIEW.T
    room.plot(*trail.T, color=theme["tx"], linewidth=2.5, alpha=0.6)
    place = walk[i] @ VIEW.T
    foot = (walk[i] * [1, 1, 0]) @ VIEW.T
    room.plot(*np.transpose([place, foot]), color=theme["tx"], linewidth=1.2, linestyle=":")
    receiver = model["pose.position"] @ VIEW.T
    room.plot(*receiver, marker="v", markersize=15, color=theme["rx"], markeredgecolor=theme["paper"])
    room.plot(*place, marker="o", markersize=15, color=theme["tx"], markeredgecolor=theme["paper"])
    corners = scene[0].reshape(-1, 3) @ VIEW.T
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    room.set(xlim=(x0 - 0.25, x1 + 0.25), ylim=(y0 - 0.5, y1 + 0.2), aspect="equal")
    room.axis("off")
    halo = [withStroke(linewidth=4, foreground=theme["paper"])]
    label = {"fontsize": 14, "fontweight": "bold", "path_effects": halo}
    room.text(receiver[0], receiver[1] + 0.28, "receiver", color=theme["rx"], ha="center", va="bottom", **label)
    room.text(place[0] + 0.35, place[1], "transmitter", color=theme["tx"], ha="left", va="center", **label)
    figure.text(0.015, 0.93, "simulated office", fontweight="bold", **ink)
    figure.text(0.015, 0.03, "Gaussians (brighter: stronger)", **ink)
    for k, name in enumerate(("predicted", "simulated")):
        bottom = 0.555 - 0.43 * k
        axes = figure.add_axes((0.60, bottom, 0.385, 0.33))
        axes.imshow(spectra[k][i], origin="lower", aspect="auto", cmap=SCALE, vmin=0, vmax=1)
        axes.set(xticks=[], yticks=[])
        figure.text(0.60, bottom + 0.345, f"{name} spectrum", fontweight="bold", **ink)
    figure.text(0.60, 0.03, "azimuth 0° to 360°  →", **ink)
    figure.text(0.575, 0.50, "elevation  →", rotation=90, va="center", ha="center", **ink)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", facecolor=theme["paper"])
    plt.close(figure)
    return Image.open(buffer).convert("RGB")


def main():
    run, program = sys.argv[1], (sys.argv[2:] or ["pwrfgs"])[0]
    walk, scene = path(), furniture()
    with tempfile.TemporaryDirectory() as folder:
        spectra, model, weights = observations(program, run, walk, Path(folder))
    for name, theme in THEMES.items():
        frames = [draw(theme, i, walk, spectra, model, weights, scene) for i in range(FRAMES)]
        out = HERE / f"drag-{name}.webp"
        options = {"duration": FRAME_MS, "loop": 0, "quality": 40, "method": 4}
        frames[0].save(out, save_all=True, append_images=frames[1:], **options)
        print(f"{out.name}: {out.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
