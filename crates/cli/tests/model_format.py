"""Predicts from a model file with NumPy alone, and compares with `pwrfgs predict`.

This file specifies what a model predicts: copy it to use a model without pwrfgs. docs/model-format.md lists the tensors.

    python3 model_format.py MODEL.safetensors FOLDER [MODEL FOLDER ..]

FOLDER is what `pwrfgs predict MODEL --tx-csv .. --out FOLDER` wrote. For a model that reads features, which `predict`
refuses, FOLDER has the same files and features.npy [rows, width]. Needs NumPy and nothing else. Numbers are in double
precision here and in single in the program; hence the tolerances, all but DECIBELS shares of the largest value:

* CLOSE: what rounding does to a pixel of splats;
* EDGE: what one Gaussian may do whose alpha is so near to 1/255 that rounding decides whether it counts, which may
  happen in FEW of the pixels and two more;
* TURNED: what rounding does to a sum of waves, whose phases are hundreds of radians;
* DECIBELS: what it does to a received power of splats, dB.
"""

import csv
import json
import re
import sys
from pathlib import Path

import numpy as np

CLOSE, EDGE, FEW, TURNED, DECIBELS = 1e-5, 2e-2, 1e-3, 1e-3, 1e-4
LIGHT = 299792458


# The file.


def read_safetensors(path):
    """The models in a file, one or several: the tensors of each by name, in double precision, and its note."""
    data = Path(path).read_bytes()
    start = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:start])
    note = json.loads(header.pop("__metadata__")["pwrfgs"])
    types = {"I8": "<i1", "F16": "<f2", "F32": "<f4", "F64": "<f8"}
    tensors = {}
    for name, entry in header.items():
        first, end = entry["data_offsets"]
        values = np.frombuffer(data[start + first : start + end], types[entry["dtype"]])
        tensors[name] = values.reshape(entry["shape"]).astype(float)
    for name in [name for name in tensors if f"{name}.scales" in tensors]:
        tensors[name] *= tensors.pop(f"{name}.scales")[:, None]
    if "members" not in note:
        return [(tensors, local(note))]
    members = []
    residuals = {"residuals": note.get("residuals")}
    for place, member in enumerate(note["members"]):
        prefix = f"members.{place}."
        own = {name[len(prefix) :]: values for name, values in tensors.items() if name.startswith(prefix)}
        own |= {name: values for name, values in tensors.items() if name.startswith("residuals.")}
        members.append((own, local(member["model"]) | residuals))
    return members


def local(note):
    """The note with everything counted from the origin, and the settings of the method as its own keys."""
    note["origin"] = np.array(note.get("origin", [0, 0, 0]), dtype=float)
    settings = read_ron(note["method"])
    note |= {"calibration": {"": "Physical"}, "readout": {"": "Magnitude"}} | settings | {"method": settings[""]}
    note["settings"] = settings
    for receiver in note["links"]["receivers"]:
        receiver["pose"]["position"] = receiver["pose"]["position"] - note["origin"]
    return note


def read_ron(text):
    """`Name(field: 1, other: Waves(count: 2), third: None)` as a dictionary; the name is under ""."""
    tokens = re.findall(r"[A-Za-z_]\w*|[-+]?[\d.]+(?:e[-+]?\d+)?|[():,\[\]]", text)

    def value():
        token = tokens.pop(0)
        if token in ("(", "["):
            items = []
            while tokens[0] not in (")", "]"):
                items.append(value())
                if tokens[0] == ",":
                    tokens.pop(0)
            tokens.pop(0)
            return items
        if not re.match("[A-Za-z_]", token):
            return float(token)
        if token in ("None", "true", "false"):
            return {"None": None, "true": True, "false": False}[token]
        fields = {"": token}
        if tokens and tokens[0] == "(":
            tokens.pop(0)
            while tokens[0] != ")":
                # A field has a name; the one value of `Octaves(5)` has none and is kept under 0.
                named = tokens[1] == ":"
                key = tokens[0] if named else 0
                del tokens[: 2 if named else 0]
                fields[key] = value()
                if tokens[0] == ",":
                    tokens.pop(0)
            tokens.pop(0)
        return fields[0] if token == "Some" else fields

    return value()


# What the network adds.


def octaves(x, frequencies):
    """x, sin x, cos x, sin 2x, cos 2x, sin 4x, ..: blocks of three numbers."""
    blocks = [x]
    for f in range(frequencies):
        blocks += [np.sin(2.0**f * x), np.cos(2.0**f * x)]
    return np.concatenate(blocks, axis=-1)


def encode(x, settings, vectors):
    """The encoding of `Factored`."""
    if settings[""] == "Octaves":
        return octaves(x, int(settings[0]))
    phase = x @ vectors.T
    in_turn = np.stack([np.sin(phase), np.cos(phase)], axis=-1).reshape(*x.shape[:-1], -1)
    scale = 2 * np.pi / settings["longest_m"] if settings[""] == "Wavelengths" else 1
    return np.concatenate([scale * x, in_turn], axis=-1)


def relu(x):
    return np.maximum(x, 0)


def layer(tensors, name):
    weight, bias = tensors[f"network.{name}.weight"], tensors[f"network.{name}.bias"]
    return lambda x: x @ weight.T + bias


def trunk(tensors, settings, inputs):
    """The ReLU stack; the inputs come in again before the outputs of layer `skip`."""
    h = inputs
    for k in range(int(settings["depth"])):
        if settings["skip"] is not None and k == settings["skip"] + 1:
            h = np.concatenate([inputs, h], axis=-1)
        h = relu(layer(tensors, f"trunk.{k}")(h))
    return h


def mlp(tensors, settings, means, tx, carrier):
    gamma = np.concatenate([octaves(tx, int(settings["tx_frequencies"])), carrier])
    e = layer(tensors, "tx.1")(relu(layer(tensors, "tx.0")(gamma)))
    position = octaves(means, int(settings["position_frequencies"]))
    h = trunk(tensors, settings, np.concatenate([position, np.tile(e, (len(means), 1))], axis=1))
    heads = ["rotation", "scaling", "signal"] if settings["outputs"][""] == "All" else ["signal"]
    return {head: layer(tensors, head)(h) for head in heads}


def factored(tensors, settings, means, told, carrier):
    encoding, own = settings["tx_encoding"], []
    if encoding[""] == "Features":
        t = own = layer(tensors, "tx.white")(encoding["gain"] * told)
    elif encoding[""] == "PseudoPosition":
        t = octaves(2 * np.tanh(layer(tensors, "tx.pseudo")(encoding["gain"] * told)), int(encoding["octaves"]))
    else:
        t = encode(told, encoding, tensors.get("constants.tx_encoding"))
    t = np.concatenate([t, carrier])
    for k in range(int(settings["depth"])):
        t = relu(layer(tensors, f"tx.{k}")(t))
    t = np.concatenate([t, own])
    waves = encode(means, settings["position_encoding"], tensors.get("constants.position_encoding"))[:, 3:]
    waves = waves * np.pi / (2 * waves.shape[1])
    real, imaginary = np.split(layer(tensors, "branch")(waves), 2, axis=1)
    signal = np.stack([g[:, :-1] @ t + g[:, -1] for g in (real, imaginary)], axis=1)
    if (near := settings["near"]) is not None:
        distance = np.sqrt(np.sum((told - tensors["network.near.positions"]) ** 2, axis=1))
        length = near["length_m"]
        correlation = np.where(distance < 16 * length, 6 * np.exp(-distance / length), 0)
        parts = np.split(tensors["network.near.weight"], 2)
        signal += np.stack([waves @ (part.T @ correlation) for part in parts], axis=1)
    return {"signal": signal}


def wrfgs(tensors, settings, means, tx, position):
    frequencies = int(settings["frequencies"])
    gamma = octaves(means, frequencies)
    h = trunk(tensors, settings, gamma)
    from_tx = np.tile(octaves(tx, frequencies), (len(means), 1))
    offset = octaves((means.astype("f4") - tx.astype("f4")).astype(float), frequencies)
    h1 = relu(layer(tensors, "sig.0")(np.concatenate([layer(tensors, "feat")(h), from_tx, offset], axis=1)))
    s = layer(tensors, "out")(relu(layer(tensors, "sig.1")(h1)))[:, 0]
    a = layer(tensors, "attn")(h)[:, 0]
    amplitude = lambda z: np.where(z < 0, -0.01 * z, z)
    gain = settings["gain"]
    if gain is None:
        gain = 40 * np.sqrt(np.sum((means - position) ** 2))
    return {"signal": np.stack([gain * amplitude(s) * amplitude(a), np.zeros(len(means))], axis=1)}


def deform(tensors, note, told):
    """What is added to rotations, scales and signals, each absent where the transmitter leaves it alone."""
    settings, means = note["deformation"], tensors["gaussians.means"]
    carrier = [settings["carrier"] * note["carrier"]] if settings.get("carrier") else []
    if settings[""] == "Mlp":
        return mlp(tensors, settings, means, told, carrier)
    if settings[""] == "Factored":
        return factored(tensors, settings, means, told, carrier)
    if settings[""] == "Wrfgs":
        return wrfgs(tensors, settings, means, told, np.array(note["links"]["receivers"][0]["pose"]["position"]))
    assert settings[""] == "Fixed"
    return {}


# From parameters to Gaussians.


def activate(tensors, note, added):
    """Scales, quaternions, opacities, and signals with one or two channels."""
    physical = note["calibration"][""] == "Physical"
    unit = lambda q: q / np.linalg.norm(q, axis=1, keepdims=True)
    scales = np.exp(tensors["gaussians.log_scales"]) + added.get("scaling", 0)
    quats = unit(tensors["gaussians.quats"]) + added.get("rotation", 0)
    if physical:
        scales, quats = np.maximum(scales, 1e-4), unit(quats)
    opacities = 1 / (1 + np.exp(-tensors["gaussians.opacity_logits"][:, 0]))
    delta = added.get("signal", 0)
    if note["deformation"][""] == "Wrfgs":
        signals = delta
    else:
        signals = tensors["gaussians.signals"] + (delta if physical else np.abs(delta))
    if not physical:
        signals = np.maximum(0.28209479177387814 * signals + 0.5, 0)
    return scales, quats, opacities, signals[:, : 1 if note["readout"][""] == "Real" else 2]


def matrix(q):
    """Rotation matrices [.., 3, 3] of quaternions w, x, y, z by the formula for unit ones, whatever their length."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), [0, 1], [-2, -1])


def to_world(pose):
    """The rotation from the receiver's axes to the world's."""
    x, y, z, w = np.array(pose["orientation"]) / np.linalg.norm(pose["orientation"])
    return matrix(np.array([w, x, y, z]))


# From space to the picture.


def mercator(settings, v, width, height, elevation):
    """Pixels [N, 2], Jacobians [N, 2, 3], and which Gaussians are near enough to the picture and far enough away."""
    x, y, z = v.T
    r = np.linalg.norm(v, axis=1)
    on_axis = np.hypot(x, y) <= 1e-6 * r
    x, y = np.where(on_axis, 1e-9 * r, x), np.where(on_axis, 0, y)  # azimuth 0
    rho = np.hypot(x, y)
    per_column, per_row = width / (2 * np.pi), 1 / np.radians(elevation["step"])  # pixels a radian
    first, end = elevation["first"], elevation["first"] + height * elevation["step"]
    pixels = np.stack([np.arctan2(y, x) % (2 * np.pi) * per_column, (np.arctan2(z, rho) - np.radians(first)) * per_row], axis=1)
    floored = rho * np.maximum(rho, np.cos(np.radians(89.5)) * r)
    around = np.stack([-y, x, 0 * x], axis=1) / floored[:, None]
    up = np.stack([-z * x / rho, -z * y / rho, rho], axis=1) / (r * r)[:, None]
    lowest = min(first, end) - settings["margin_deg"]
    visible = (r > settings["near_m"]) & ((lowest <= -90) | (z >= np.sin(np.radians(lowest)) * r))
    return pixels, np.stack([around * per_column, up * per_row], axis=1), visible


def pinhole(settings, v, width, height, camera):
    """The same for `Pinhole`."""
    z, focal, centre = v[:, 2:], np.array(camera["focal"]), np.array(camera["centre"])
    slopes, size, margin = v[:, :2] / z, np.array([width, height]), settings["margin"]
    s, t = np.clip(slopes, (-margin * size - centre) / focal, ((1 + margin) * size - centre) / focal).T
    one, none = np.ones_like(s), np.zeros_like(s)
    rows = np.stack([np.stack([one, none, -s], axis=1), np.stack([none, one, -t], axis=1)], axis=1)
    return focal * slopes + centre - 0.5, rows * (focal / z)[:, :, None], z[:, 0] >= settings["near_m"]


def released(v, width, height):
    """The same for `WrfgsCompat`."""
    x, y, z = v.T
    r, rho = np.linalg.norm(v, axis=1), np.hypot(x, z)
    longitude, latitude = np.arctan2(x, z), np.arcsin(np.clip(y / (r + 1e-7), -1, 1))
    pixels = np.stack(
        [((longitude / np.pi + 1) * width - 1) / 2, ((2 * latitude / np.pi + 1) * height - 1) / 2], axis=1
    )
    a, p, q = 1 / (rho**2 + 1e-7), 1 / (rho + 1e-7), 1 / (r**2 + 1e-7)
    around = np.stack([z * a, 0 * a, -x * a], axis=1) * width / (2 * np.pi)
    up = np.stack([-x * y * p * q, rho * q, -z * y * p * q], axis=1) * height / np.pi
    return pixels, np.stack([around, up], axis=1), r**2 > 0.04


def square(pixels, radii, count):
    """First tile and the one after the last that meet the square of this radius, along one axis."""
    tiles = -(-count // 16)
    first = np.trunc((pixels - radii) / 16).clip(0, tiles)
    return first, np.trunc((pixels + radii + 15) / 16).clip(0, tiles)


def project(projector, pose, plane, means, scales, quats):
    """Centres on the picture, covariances [N, 2, 2], distances, radii (0: not drawn), directions."""
    width, height = plane["width"], plane["height"]
    to_receiver = to_world(pose).T
    if projector[""] == "Mercator":
        v = (means - pose["position"]) @ to_receiver.T
        pixels, jacobians, visible = mercator(projector, v, width, height, plane["angles"][1])
        blur = plane.get("filter", projector["blur"])
    elif projector[""] == "Pinhole":
        v = (means - pose["position"]) @ to_receiver.T
        pixels, jacobians, visible = pinhole(projector, v, width, height, plane["camera"])
        blur = projector["blur"]
    else:
        assert projector[""] == "WrfgsCompat"
        v = means @ to_receiver.T + pose["position"]
        pixels, jacobians, visible = released(v, width, height)
        blur = 0.3
    spread = jacobians @ to_receiver @ (matrix(quats) * scales[:, None, :])
    cov = spread @ np.moveaxis(spread, 1, 2) + blur * np.eye(2)
    a, c, det = cov[:, 0, 0], cov[:, 1, 1], np.linalg.det(cov)
    middle = (a + c) / 2
    radii = np.ceil(3 * np.sqrt(middle + np.sqrt(np.maximum(middle**2 - det, 0.1))))
    if projector[""] != "WrfgsCompat":
        half = np.sqrt(2 * np.log(255) * np.stack([a, c], axis=1))
        inside = (pixels + half >= 0) & (pixels - half <= [width - 1, height - 1])
        reaches = (inside[:, 0] | plane["wraps"]) & inside[:, 1]
    else:
        spans = [square(pixels[:, k], radii, n) for k, n in ((0, width), (1, height))]
        reaches = (spans[0][0] < spans[0][1]) & (spans[1][0] < spans[1][1])
    distances = np.linalg.norm(v, axis=1)
    return pixels, cov, distances, np.where(visible & reaches, radii, 0), v / distances[:, None]


# From splats to pixels.


def blend(settings, plane, splats, opacities, signals):
    """`AlphaBlending`: [channels, H, W]."""
    pixels, cov, distances, radii, _ = splats
    rows, columns = np.mgrid[: plane["height"], : plane["width"]]
    picture = np.zeros((signals.shape[1], *rows.shape))
    light, open_ = np.ones(rows.shape), np.full(rows.shape, True)
    for i in np.argsort(distances.astype("f4"), kind="stable"):
        if radii[i] == 0:
            continue
        dx, dy = pixels[i, 0] - columns, pixels[i, 1] - rows
        if plane["wraps"]:
            dx = dx - plane["width"] * np.floor(dx / plane["width"] + 0.5)
        (a, b), (_, c) = np.linalg.inv(cov[i])
        alpha = np.minimum(0.99, opacities[i] * np.exp(-(a * dx * dx + c * dy * dy) / 2 - b * dx * dy))
        counts = open_ & (alpha >= 1 / 255)
        if settings["support"][""] == "TileSquares":
            for at, along, n in ((pixels[i, 0], columns, plane["width"]), (pixels[i, 1], rows, plane["height"])):
                first, end = square(at, radii[i], n)
                counts &= (along >= 16 * first) & (along < 16 * end)
        full = counts & (light * (1 - alpha) < 1e-4)
        open_ &= ~full
        counts &= ~full
        picture += signals[i][:, None, None] * np.where(counts, alpha * light, 0)
        light = np.where(counts, light * (1 - alpha), light)
    return picture


def directions_of(plane):
    """Unit vectors of the pixels in the receiver's frame, [H, W, 3]."""
    azimuth, elevation = plane["angles"]
    rows, columns = np.mgrid[: plane["height"], : plane["width"]]
    az = np.radians(azimuth["first"] + azimuth["step"] * columns)
    el = np.radians(elevation["first"] + elevation["step"] * rows)
    return np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=-1)


def array(settings, plane, splats, opacities, signals):
    """`ArrayResponse`: [2, H, W], real and imaginary part."""
    pixels, cov, distances, radii, u = splats
    azimuth, elevation = plane["angles"]
    # The antennas [K, 3], wavelengths.
    place = lambda count: (np.arange(count) - (count - 1) / 2) * settings["spacing_wavelengths"]
    ys, xs = np.meshgrid(place(int(settings["rows"])), place(int(settings["columns"])), indexing="ij")
    grid = np.stack([xs.ravel(), ys.ravel(), 0 * xs.ravel()], axis=1)
    p = np.array(settings.get("positions_wavelengths", grid))
    # What each Gaussian leaves on them, [N, K].
    phase = 2 * np.pi * u @ p.T
    if settings["wavefront"][""] == "Spherical":
        r = (distances / settings["wavefront"]["wavelength_m"])[:, None]
        way = np.sqrt(np.maximum(r**2 - 2 * r * (u @ p.T) + np.sum(p * p, axis=1), 1e-6))
        phase = -2 * np.pi * (way - r)
    waves = np.exp(1j * phase)
    if settings["widened"]:
        az = np.radians(azimuth["first"] + azimuth["step"] * pixels[:, 0])
        el = np.radians(elevation["first"] + elevation["step"] * pixels[:, 1])
        by_column = np.stack([-np.sin(az) * np.cos(el), np.cos(az) * np.cos(el), 0 * az], axis=1)
        by_row = np.stack([-np.cos(az) * np.sin(el), -np.sin(az) * np.sin(el), np.cos(el)], axis=1)
        turns = [by_column * np.radians(azimuth["step"]), by_row * np.radians(elevation["step"])]
        wv = np.stack([t @ p.T for t in turns], axis=1)  # [N, 2, K]
        waves = waves * np.exp(-((2 * np.pi) ** 2) / 2 * np.einsum("nik,nij,njk->nk", wv, cov, wv))
    amplitudes = np.where(radii > 0, opacities, 0) * (signals[:, 0] + 1j * signals[:, 1])
    field = amplitudes @ waves
    # The array steered to every pixel.
    heard = np.exp(-2j * np.pi * directions_of(plane) @ p.T) @ field / len(p)
    return np.stack([heard.real, heard.imag])


def read_out(readout, picture):
    if readout == "Real":
        return picture[0]
    power = picture[0] ** 2 + picture[1] ** 2
    if readout == "Power":
        return power
    magnitude = np.sqrt(power)
    if readout == "Magnitude":
        return magnitude
    low, high = magnitude.min(), magnitude.max()
    return (magnitude - low) / (high - low) if high - low > 1e-6 * high else 0 * magnitude


def drawn(tensors, note, told, pose, plane):
    """Blended signals or waves of all Gaussians at a receiver, [channels, H, W]."""
    scales, quats, opacities, signals = activate(tensors, note, deform(tensors, note, told))
    splats = project(note["projector"], pose, plane, tensors["gaussians.means"], scales, quats)
    rasterizer = note["rasterizer"]
    draw = {"AlphaBlending": blend, "ArrayResponse": array}[rasterizer[""]]
    return draw(rasterizer, plane, splats, opacities, signals)


# Received powers.


def received(tensors, note, told, receiver):
    """`readout: ReceivedPower`: dBm."""
    readout, pose = note["readout"], note["links"]["receivers"][receiver]["pose"]
    step = readout["sky_deg"]
    elevations = np.arange(-90, 91, step)
    angles = [{"first": 0, "step": step}, {"first": -90, "step": step}]
    plane = {"width": 360 // step, "height": len(elevations), "wraps": True, "angles": angles}
    plane["filter"] = readout["filter_deg2"] / step**2
    edges = [np.sin(np.radians(np.clip(elevations + side * step / 2, -90, 90))) for side in (-1, 1)]
    sky = np.sum(drawn(tensors, note, told, pose, plane) ** 2, axis=0)
    power = np.sum(sky * (np.radians(step) * (edges[1] - edges[0]))[:, None]) + 1e-12
    offset, exponent = (tensors[f"network.receiver.{name}"][receiver] for name in ("offsets", "exponents"))
    far = np.log10(max(np.linalg.norm(told - pose["position"]), 0.5)) if len(told) == 3 else 0
    return 10 * (np.log10(power) + offset - exponent * far)


# Carriers and channels.


def carrier_of(note, receiver):
    """The carrier as a network input; 0 for one carrier."""
    hz = [own.get("carrier_hz") for own in note["links"]["receivers"]]
    if None in hz or min(hz) == max(hz):
        return 0
    return 2 * np.log(hz[receiver] / min(hz)) / np.log(max(hz) / min(hz)) - 1


def frequencies(note, receiver):
    """Subcarriers of a receiver, Hz."""
    f, carrier = np.array(note["links"]["frequencies_hz"]), note["links"]["receivers"][receiver].get("carrier_hz")
    return f if carrier is None else carrier + (f - np.mean(f))


def spherical(tensors, note, told, receiver):
    """`SplattedChannel`: [A, F]."""
    own, f = note["links"]["receivers"][receiver], frequencies(note, receiver)
    antennas = own["pose"]["position"] + np.array(own["antennas"]) @ to_world(own["pose"]).T
    signals = activate(tensors, note, deform(tensors, note, told))[3]
    way = np.linalg.norm(tensors["gaussians.means"][:, None] - antennas, axis=2)
    d = np.maximum(way, 0.05)[:, :, None]  # [N, A, 1]
    waves = np.exp(-2j * np.pi * f * d / LIGHT) / d
    level = 10 ** tensors["network.receiver.offsets"][receiver]
    return level * np.einsum("n,naf->af", signals[:, 0] + 1j * signals[:, 1], waves)


def harmonics(u):
    """Real spherical harmonics up to the third degree with a mean square of 1, [.., 16]."""
    x, y, z = np.moveaxis(u, -1, 0)
    a, b, c = np.sqrt(35 / 8), np.sqrt(105), np.sqrt(21 / 8)
    first = [0 * x + 1, *(np.sqrt(3) * np.array([y, z, x]))]
    second = [x * y, y * z, (3 * z * z - 1) / np.sqrt(12), z * x, (x * x - y * y) / 2]
    third = [a * y * (3 * x * x - y * y), b * x * y * z, c * y * (5 * z * z - 1), np.sqrt(7) / 2 * z * (5 * z * z - 3)]
    third += [c * x * (5 * z * z - 1), b / 2 * z * (x * x - y * y), a * x * (x * x - 3 * y * y)]
    return np.stack([*first, *(np.sqrt(15) * np.array(second)), *third], axis=-1)


def virtual_transmitters(tensors, note, p, receiver):
    """`VirtualTransmitters`: [A, F]."""
    own, f = note["links"]["receivers"][receiver], frequencies(note, receiver)
    antennas = np.array(own["antennas"]) @ to_world(own["pose"]).T
    v, quats = tensors["gaussians.means"], tensors["gaussians.quats"]
    turned = matrix(quats / np.linalg.norm(quats, axis=1, keepdims=True)) @ antennas.T  # [N, 3, A]
    u = (p - v) / np.linalg.norm(p - v, axis=1, keepdims=True)
    gains = np.concatenate([tensors["gaussians.signals"], tensors.get("gaussians.harmonics", np.zeros((len(v), 0)))], 1)
    gains = gains[:, ::2] + 1j * gains[:, 1::2]
    s = np.sum(gains * harmonics(u)[:, : gains.shape[1]], axis=1)
    d = np.linalg.norm(p[:, None] - v[:, :, None] - turned, axis=1)[:, :, None]
    return np.sum(s[:, None, None] * np.exp(-2j * np.pi * f * d / LIGHT) / d, axis=0)


# NeRF2.


def rays(settings, note, receiver):
    """Unit vectors in the world, [R, 3]."""
    if note["links"]["kind"] == "Spectrum":
        own = directions_of(note["plane"])
    else:
        rings, around = int(settings["elevations"]), int(settings["azimuths"])
        el = np.pi / 2 * np.arange(1, rings + 1)[:, None] / rings
        az = 2 * np.pi * np.arange(around) / around
        own = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el) + 0 * az], axis=-1)
    return own.reshape(-1, 3) @ to_world(note["links"]["receivers"][receiver]["pose"]).T


def strength_and_angle(raw):
    """Amplitudes and phases from a layer's outputs, of which the second half are phases."""
    amplitudes, phases = np.split(raw, 2, axis=-1)
    return np.where(amplitudes > 0, amplitudes, -0.01 * amplitudes), 2 * np.pi / (1 + np.exp(-phases))


def on_the_way(t, attenuation, turn, wavenumber):
    """What is left of each sample's wave [R, n, B] at the receiver; no wavenumber: of a spectrum."""
    steps = np.append(np.diff(t), 1e10)[:, None]
    if wavenumber is None:
        before = lambda x: np.concatenate([0 * x[:, :1], np.cumsum(x, axis=1)[:, :-1]], axis=1)
        left = before(np.log(np.exp(-attenuation * steps) + 1e-10))
        return 0.025 / np.append(t[1:], 1e10)[:, None] * np.exp(left + 1j * (1 + before(turn * steps)))
    left = np.exp(np.cumsum(-attenuation * steps + 1j * (turn - np.pi + wavenumber * steps), axis=1))
    return np.where(steps < 1e10, left, 0)


def nerf2(tensors, settings, note, told, receiver):
    """`Nerf2`: a spectrum [H, W], a power in dBm, or a channel [1, F]."""
    unit, n, depth = settings["unit_m"], int(settings["samples"]), int(settings["depth"])
    t = settings["far_m"] / unit * np.arange(n) / (n - 1)
    ways = rays(settings, note, receiver)
    x = note["links"]["receivers"][receiver]["pose"]["position"] / unit + ways[:, None] * t[:, None]
    h = trunk(tensors, {"depth": depth, "skip": 4 if depth > 5 else None}, octaves(x, 10))
    kind = note["links"]["kind"]
    wavenumber = None if kind == "Spectrum" else 2 * np.pi * settings["carrier_hz"] / LIGHT
    left = on_the_way(t, *strength_and_angle(layer(tensors, "attenuation")(h)), wavenumber)
    told = told if settings["features"] else octaves(told / unit, 10)
    wide = lambda own: np.broadcast_to(own, (*h.shape[:2], own.shape[-1]))
    inputs = [layer(tensors, "feature")(h), wide(octaves(ways, 10)[:, None]), wide(told)]
    h = relu(layer(tensors, "signal.1")(relu(layer(tensors, "signal.0")(np.concatenate(inputs, axis=-1)))))
    s, psi = strength_and_angle(layer(tensors, "emission")(h))
    sums = np.sum(s * np.exp(1j * (psi if kind == "Spectrum" else psi - np.pi)) * left, axis=1)  # [R, B]
    if kind == "Spectrum":
        return np.abs(sums).reshape(note["plane"]["height"], -1)
    total = np.sum(sums, axis=0)
    return total[None] if kind == "Channel" else 100 * np.abs(total[0]) - 100


# Residuals.


def interpolation(size, stride, wraps):
    """Weights [size, stored] of every `stride`-th pixel: cubic convolution with a = -1/2 (Keys, 1981)."""
    count, at = -(-size // stride), np.arange(size)
    left, f = at // stride, at % stride / stride
    weights = [f**2 - (f**3 + f) / 2, 1 + 1.5 * f**3 - 2.5 * f**2, 2 * f**2 - (3 * f**3 - f) / 2, (f**3 - f**2) / 2]
    matrix = np.zeros((size, count))
    for k, weight in enumerate(weights):
        place = (left + k - 1) % count if wraps else np.clip(left + k - 1, 0, count - 1)
        np.add.at(matrix, (at, place), weight)
    return matrix


def kriged(tensors, note, p, receiver, f):
    """The prediction f of all members, times its share, plus the expected residual at the transmitter p."""
    residuals, plane = note["residuals"], note["plane"]
    process, stride = residuals["receivers"][receiver], residuals["stride"]
    if process is None:
        return f
    first = sum(own["links"] for own in residuals["receivers"][:receiver] if own)
    rows = slice(first, first + process["links"])
    places, at = tensors["residuals.places"][rows] / process["scales_m"], p / process["scales_m"]
    values = tensors["residuals.values"][rows] * tensors.get("residuals.units", np.ones(rows.stop))[rows, None]
    distances = np.linalg.norm(places - at, axis=1)
    near = np.argsort(distances, kind="stable")[: residuals["neighbours"]]
    correlation = {
        "Exponential": lambda d: np.exp(-d),
        "Matern32": lambda d: (1 + np.sqrt(3) * d) * np.exp(-np.sqrt(3) * d),
        "SquaredExponential": lambda d: np.exp(-(d**2) / 2),
        "LongTail": lambda d: 1 / (1 + d),
    }[process["correlation"]]
    between = np.linalg.norm(places[near, None] - places[near], axis=2)
    covariance = correlation(between) + process["noise"] * np.eye(len(near))
    weights = np.linalg.solve(covariance, correlation(distances[near]))
    law = 0
    if process.get("path_loss"):
        level, slope = process["path_loss"]
        r = np.linalg.norm(p - note["links"]["receivers"][receiver]["pose"]["position"])
        law = level - slope * np.log10(max(r, 0.01))
    else:  # the mean of the residuals is unknown: weights sum to 1
        ones = np.linalg.solve(covariance, np.ones(len(near)))
        weights += ones * (1 - weights.sum()) / ones.sum()
    sizes = [(plane["height"], False), (plane["width"], plane["wraps"] and plane["width"] % stride == 0)]
    up, along = (interpolation(size, stride, wraps) for size, wraps in sizes)
    coarse = (weights @ values[near]).reshape(up.shape[1], along.shape[1])
    return process["share"] * f + (1 - process["share"]) * law + (up @ coarse @ along.T).reshape(np.shape(f))


# Every kind of model.


def predict(tensors, note, tx, features, receiver):
    """A spectrum [H, W], a power in dBm, or a channel [A, F] of a transmitter at `tx` (metres), or of `features`."""
    note["carrier"] = carrier_of(note, receiver)
    told = (np.array(tx) - note["origin"]).astype("f4").astype(float) if features is None else features
    if note["method"] == "Nerf2":
        return nerf2(tensors, note["settings"], note, told, receiver)
    if note["method"] == "VirtualTransmitters":
        return virtual_transmitters(tensors, note, told, receiver)
    if note["method"] == "SplattedChannel":
        return spherical(tensors, note, told, receiver)
    if note["readout"][""] == "ReceivedPower":
        return received(tensors, note, told, receiver)
    pose = note["links"]["receivers"][receiver]["pose"]
    return read_out(note["readout"][""], drawn(tensors, note, told, pose, note["plane"]))


def is_same(note, found, expected):
    """Whether rounding explains what is between the two, and how much it is."""
    kind, error = note["links"]["kind"], np.abs(found - expected)
    assert found.shape == np.shape(expected)
    if kind == "Power":
        return error < (TURNED * abs(expected + 100) if note["method"] == "Nerf2" else DECIBELS), f"{error:.1e} dB"
    assert np.abs(expected).max() > (np.abs(expected).min() if kind == "Spectrum" else 0), "something on it"
    error = error / np.abs(expected).max()
    if note["method"] != "Splatting":
        return error.max() < TURNED, f"largest {error.max():.1e}"
    many = np.sum(error > CLOSE)
    return error.max() <= EDGE and many <= FEW * error.size + 2, f"largest {error.max():.1e}, {many} beyond"


def compare(model, folder):
    """Whether every prediction in the folder is what the file says."""
    members, folder, good = read_safetensors(model), Path(folder), True
    note = members[0][1]
    names = [receiver["name"] for receiver in note["links"]["receivers"]]
    features = np.load(folder / "features.npy").astype(float) if (folder / "features.npy").exists() else None
    for k, row in enumerate(csv.DictReader((folder / "predictions.csv").open())):
        tx, own = [float(row[axis]) for axis in "xyz"], None if features is None else features[k]
        receiver = names.index(row["receiver"]) if "receiver" in row else 0
        each = [predict(*member, tx, own, receiver) for member in members]
        is_clamped = "residuals" in note and note["links"]["kind"] == "Spectrum"
        expected = np.mean(np.clip(each, 0, 1) if is_clamped else each, axis=0)
        if note.get("residuals"):
            expected = kriged(members[0][0], note, np.array(tx) - note["origin"], receiver, expected)
        found = np.array(float(row["dbm"])) if "dbm" in row else np.load(folder / f"{int(row['row']):05}.npy")
        fine, said = is_same(note, found, expected)
        good &= fine
        print(f"{'same' if fine else 'DIFFERENT'} {model} {row['row']}: {said}")
    return good


if __name__ == "__main__":
    pairs = sys.argv[1:]
    results = [compare(*pair) for pair in zip(pairs[::2], pairs[1::2])]
    sys.exit(0 if results and all(results) else 1)
