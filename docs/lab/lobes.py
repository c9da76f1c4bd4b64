import math, os, random, struct, sys

HEIGHT, WIDTH, COUNT = 90, 360, 400
RECEIVER = (4.0, 3.0, 0.0)  # metres, on the floor; the room is 8 x 6 m

def at(azimuth, elevation):  # degrees
    a, e = math.radians(azimuth), math.radians(elevation)
    return [math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)]

def towards(point):
    d = [a - b for a, b in zip(point, RECEIVER)]
    norm = math.sqrt(sum(v * v for v in d))
    return [v / norm for v in d]

def step(v):
    return 1 / (1 + math.exp(-v))

def lobes(kind, x, y, z):  # direction, height, standard deviation in degrees
    if kind == "move":  # line of sight and two walls
        return [(towards((x, y, z)), 1.0, 14), (towards((-x, y, z)), 0.6, 14), (towards((x, 12 - y, z)), 0.45, 14)]
    if kind == "appear":  # line of sight and three fixed lobes
        return [(towards((x, y, z)), 0.7, 14), (at(40, 30), step((x - 4) / 0.3), 16),
                (at(160, 50), step((y - 3) / 0.3) * 0.8, 14),
                (at(280, 25), math.exp(-((x - 2) ** 2 + (y - 1.5) ** 2) / 1.0), 18)]
    return [(at(60 + 30 * x, 25 + 6 * y), 1.0, 13), (at(300 - 30 * x, 25 + 6 * (6 - y)), 0.8, 13)]  # cross

kind, folder = sys.argv[1], sys.argv[2]
draw = random.Random(5)
positions = [(draw.uniform(0, 8), draw.uniform(0, 6), draw.uniform(0.8, 1.8)) for _ in range(COUNT)]
directions = [[at(column, row) for column in range(WIDTH)] for row in range(HEIGHT)]
pixels = bytearray()
for position in positions:
    # Each height fluctuates by 12 %.
    drawn = [(u, h * math.exp(draw.gauss(0, 0.12)), 1 / math.radians(s) ** 2) for u, h, s in lobes(kind, *position)]
    for q in (q for row in directions for q in row):
        value = 0.0
        for u, height, width in drawn:
            t = (u[0] * q[0] + u[1] * q[1] + u[2] * q[2] - 1) * width
            if t > -8:
                value += height * math.exp(t)
        pixels.append(min(255, int(255 * value / 1.1 + 0.5)))

def save(name, number, shape, data):
    head = repr({"descr": number, "fortran_order": False, "shape": shape})
    head += " " * (63 - (10 + len(head)) % 64) + "\n"
    with open(f"{folder}/{name}", "wb") as file:
        file.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode() + data)

os.makedirs(folder)
save("spectra.npy", "|u1", (COUNT, HEIGHT, WIDTH), bytes(pixels))
save("tx.npy", "<f8", (COUNT, 3), struct.pack(f"<{3 * COUNT}d", *[v for p in positions for v in p]))
with open(f"{folder}/gateway_info.yml", "w") as file:
    file.write("gateway1:\n  position: [4.0, 3.0, 0.0]\n  orientation: [0.0, 0.0, 0.0, 1.0]\n")
