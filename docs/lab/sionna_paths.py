"""Compares propagation paths of pwrfgs with those of Sionna RT in the same Mitsuba scenes.

pip install sionna-rt numpy     # on a CPU also DRJIT_LIBLLVM_PATH=/path/to/libLLVM.so, LLVM 17 or newer
python3 docs/lab/sionna_paths.py [--pwrfgs PROGRAM] [--diffraction] [--scattering] [SCENE ..]
"""
import argparse, csv, os, pathlib, resource, subprocess, tempfile, time

import numpy as np

# Receiver, and smallest and largest transmitter position, metres.
ANTENNAS = {
    "box": ((-2, -1, 1.7), (-4, -4, 0.5), (4, 4, 4.5)),
    "box_one_screen": ((-2, -1, 1.7), (-4, -4, 0.5), (4, 4, 4.5)),
    "floor_wall": ((1.2, -0.5, 1.6), (-1.8, -1.8, 0.3), (-0.3, 1.8, 2.5)),
    "simple_reflector": ((0.2, 0.1, 1), (-0.8, -0.8, 0.5), (0.8, 0.8, 1.5)),
    "simple_wedge": ((10, 6, 1), (-12, -20, -4), (-2, -5, 4)),
    "simple_street_canyon": ((20, -2, 1.5), (-40, -6, 1.5), (40, 7, 12)),
}
LETTERS = {1: "R", 2: "S", 4: "T", 8: "D"}
HZ, ORDER, COUNT = 3.5e9, 2, 10
DEPTH = ORDER + 2  # largest number of interactions of a compared path

parser = argparse.ArgumentParser()
parser.add_argument("scenes", nargs="*", default=list(ANTENNAS))
parser.add_argument("--pwrfgs", default="pwrfgs")
parser.add_argument("--diffraction", action="store_true")
parser.add_argument("--scattering", action="store_true")
options = parser.parse_args()

def seconds_of_pwrfgs():  # processor time
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime

def unit(azimuth, elevation):  # degrees
    a, e = np.radians(azimuth), np.radians(elevation)
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])

def ours(xml, antennas, folder):
    """Transmitter positions, and per transmitter the paths (letters, gain, delay in ns, arrival, departure)."""
    receiver, low, high = ("({}, {}, {})".format(*place) for place in antennas)
    (folder / "scene.ron").write_text(f"""(name: "compared", carrier_hz: {HZ}, mitsuba: "{xml}",
        receiver: (position: {receiver}, orientation: Facing(direction: (1, 0, 0)), array: (rows: 1, columns: 1)),
        transmitter: (positions: Uniform(low: {low}, high: {high})),
        propagation: (order: {ORDER}, diffraction: {str(options.diffraction).lower()},
            roughness: {0.3 if options.scattering else 0.0}, patch_m: 0.25))""")
    subprocess.run([options.pwrfgs, "simulate", "scene.ron", "--samples", str(COUNT), "--points", "0", "--npy",
                    "--out", "out", "-q"], cwd=folder, check=True)
    places = np.loadtxt(folder / "out/tx_pos.csv", delimiter=",", skiprows=1)
    paths = [[] for _ in places]
    for row in csv.DictReader((folder / "out/paths.csv").open()):
        value = lambda name: float(row[name])
        letters = row["interactions"]
        if len(letters) > DEPTH or ("S" in letters and letters not in ("S", "LOS")):
            continue
        paths[int(row["id"]) - 1].append((
            row["interactions"], complex(value("gain_re"), value("gain_im")), value("delay_ns"),
            unit(value("arrival_azimuth_deg"), value("arrival_elevation_deg")),
            unit(value("departure_azimuth_deg"), value("departure_elevation_deg"))))
    return places, paths

def theirs(xml, antennas, places):
    import sionna.rt as rt
    begun = time.process_time()
    scene = rt.load_scene(xml)
    scene.frequency = HZ
    scene.tx_array = scene.rx_array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
    for material in scene.radio_materials.values():
        if options.scattering:
            material.scattering_coefficient = 0.3
    scene.add(rt.Receiver("rx", position=list(antennas[0])))
    scene.add(rt.Transmitter("tx", position=[0, 0, 0]))
    solver, all_paths, times = rt.PathSolver(), [], []
    for place in places:
        started = time.process_time()
        scene.get("tx").position = [float(v) for v in place]
        # Sheets and edges on a path count as interactions there, and not in `order`.
        found = solver(scene, max_depth=DEPTH, diffraction=options.diffraction, edge_diffraction=True,
                       diffuse_reflection=options.scattering)
        gains = np.array(found.a[0])[0, 0, 0, 0] + 1j * np.array(found.a[1])[0, 0, 0, 0]
        flat = lambda tensor: np.array(tensor)[0, 0]
        kinds = np.array(found.interactions)[:, 0, 0]
        angles = [90 - np.degrees(flat(found.theta_r)), 90 - np.degrees(flat(found.theta_t))]
        around = [np.degrees(flat(found.phi_r)), np.degrees(flat(found.phi_t))]
        paths = []
        for i, gain in enumerate(gains):
            letters = "".join(LETTERS[k] for k in kinds[:, i] if k) or "LOS"
            # One scattering per path, without other interactions, as here.
            is_comparable = letters in ("S", "LOS") if "S" in letters else letters.count("R") <= ORDER
            if is_comparable and abs(gain) > 0:
                paths.append((letters, gain, flat(found.tau)[i] * 1e9, unit(around[0][i], angles[0][i]),
                              unit(around[1][i], angles[1][i])))
        all_paths.append(paths)
        times.append(time.process_time() - started)
    return all_paths, time.process_time() - begun, np.median(times[2:])

def built_in(name):
    import sionna.rt as rt
    return getattr(rt.scene, name)

def pairs(a, b):
    """Pairs of paths with equal interactions and arrival, the nearest first; and the rest."""
    # Scattered paths have other points: only their power is comparable.
    free, found, alone = [path for path in b if path[0] != "S"], [], []
    for path in a:
        if path[0] == "S":
            continue
        near = [(np.linalg.norm(path[3] - other[3]) + abs(path[2] - other[2]), k) for k, other in enumerate(free)
                if other[0] == path[0]]
        distance, k = min(near, default=(1, 0))
        if distance < 0.01:
            found.append((path, free.pop(k)))
        else:
            alone.append(path)
    return found, alone, free

def power_db(paths):
    return 10 * np.log10(max(sum(abs(p[1]) ** 2 for p in paths), 1e-30))

print(f"{'scene':22} {'kind':4} {'both':>5} {'pwrfgs':>6} {'Sionna':>6} {'median':>8} {'|gain|':>8} {'gain':>8} "
      f"{'delay':>8} {'angle':>8}")
for name in options.scenes:
    stem = pathlib.Path(name).stem
    if stem not in ANTENNAS:
        parser.error(f"no antennas for {stem}; add a line to ANTENNAS in this script")
    antennas = ANTENNAS[stem]
    xml = os.path.abspath(name) if os.path.exists(name) else built_in(name)
    before = seconds_of_pwrfgs()
    with tempfile.TemporaryDirectory() as folder:
        places, mine = ours(xml, antennas, pathlib.Path(folder))
    seconds = seconds_of_pwrfgs() - before
    other, first, later = theirs(xml, antennas, places)
    both, only, missing = [], [], []
    for a, b in zip(mine, other):
        found, alone, rest = pairs(a, b)
        both, only, missing = both + found, only + alone, missing + rest
    kind = lambda path: "LOS" if path[0] == "LOS" else next(k for k in "DTR" if k in path[0])
    for k in ("LOS", "R", "T", "D"):
        chosen = [pair for pair in both if kind(pair[0]) == k]
        counts = [sum(kind(path) == k for path in paths) for paths in (only, missing)]
        if not chosen and not any(counts):
            continue
        errors = np.array([(abs(abs(a[1] / b[1]) - 1), abs(a[1] / b[1] - 1), abs(a[2] / b[2] - 1),
                            max(np.linalg.norm(a[i] - b[i]) for i in (3, 4))) for a, b in chosen] or [[np.nan] * 4])
        print(f"{name:22} {k:4} {len(chosen):5} {counts[0]:6} {counts[1]:6} {np.median(errors[:, 0]):8.1e} "
              + " ".join(f"{worst:8.1e}" for worst in errors.max(axis=0)))
    level = [power_db([p for paths in x for p in paths]) for x in (mine, other)]
    if options.scattering:
        scattered = [power_db([p for paths in x for p in paths if p[0] == "S"]) for x in (mine, other)]
        print(f"  scattered power {scattered[0]:.2f} and {scattered[1]:.2f} dB")
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # of all scenes so far
    print(f"  power of these paths {level[0]:.2f} and {level[1]:.2f} dB; processor time: pwrfgs {seconds:.2f} s, "
          f"Sionna {first:.1f} s, {later:.3f} s of it for a later transmitter, {megabytes:.0f} MB", flush=True)
