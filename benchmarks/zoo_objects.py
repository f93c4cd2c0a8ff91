"""Objects of the zoo, drawn from a generator: none is a skull. Lengths in mm, grids span 64 mm."""

import numpy as np
from scipy.spatial.transform import Rotation
from zoo_shapes import BOX, CYLINDER, ELLIPSOID, Shape

UP = (0.0, 0.0, 1.0)


def turn(rng):
    """A random rotation."""
    return Rotation.random(random_state=rng).as_matrix()


def along(direction):
    """A rotation that turns z into a direction."""
    return Rotation.align_vectors([np.asarray(direction, float)], [UP])[0].as_matrix()


def rod(start, end, radius, material, kind=CYLINDER):
    """A round rod between two points."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    half = (radius, radius, np.linalg.norm(end - start) / 2)
    return Shape(kind, tuple((start + end) / 2), half, material, along(end - start))


def ball(centre, radius, material, **more):
    """A sphere, or an ellipsoid for three radii."""
    half = tuple(np.broadcast_to(np.asarray(radius, float), 3))
    return Shape(ELLIPSOID, tuple(centre), half, material, **more)


def apart(rng, number, radii, inside, tries=4000):
    """Draw balls that do not touch, as (centre, radius); inside: half sizes of an ellipsoid."""
    found, half = [], np.asarray(inside, float)
    for _ in range(tries):
        radius, centre = rng.uniform(*radii), rng.uniform(-1, 1, 3) * half
        room = np.sum((centre / np.maximum(half - radius, 1e-6)) ** 2) < 1
        if room and all(np.linalg.norm(centre - c) > radius + r + 0.3 for c, r in found):
            found.append((centre, radius))
            if len(found) == number:
                break
    return found


def foam(rng):
    """A cylinder with closed pores of 2 to 9 mm."""
    body = Shape(CYLINDER, (0, 0, 0), (24, 22, 24), "polymer", turn(rng))
    pores = apart(rng, 150, (1.0, 4.5), (27, 27, 27))
    return [body, *(ball(centre, radius, "air") for centre, radius in pores)]


def trabecular(rng):
    """Marrow within a thin cortex, crossed by rods of 0.6 to 2 mm and a few plates."""
    half = np.array([22, 18, 24]) * rng.uniform(0.9, 1.05, 3)
    shapes = [ball((0, 0, 0), half, "bone"), ball((0, 0, 0), half - 1.6, "marrow")]
    step = 7.0
    axes = np.arange(-21, 22, step)
    nodes = np.stack(np.meshgrid(axes, axes, axes, indexing="ij"), -1)
    nodes = nodes + rng.uniform(-2, 2, nodes.shape)
    inside = np.sum((nodes / (half - 2.5)) ** 2, -1) < 1
    for place in np.ndindex(inside.shape):
        for axis in range(3):
            other = tuple(np.add(place, np.eye(3, dtype=int)[axis]))
            if max(other) < len(axes) and inside[place] and inside[other] and rng.random() < 0.7:
                shapes.append(rod(nodes[place], nodes[other], rng.uniform(0.3, 1.0), "bone"))
    for _ in range(5):
        centre = rng.uniform(-0.5, 0.5, 3) * half
        shapes.append(Shape(BOX, tuple(centre), (4, 4, 0.4), "bone", turn(rng)))
    return shapes


def gradients(rng):
    """Bodies whose density varies smoothly, in water."""
    shapes = [ball((0, 0, 0), (27, 24, 27), "water", density=(0.9, 0.06, -0.08, 0.04, 0.1))]
    for centre, radius in apart(rng, 9, (4, 9), (24, 21, 24)):
        slope = rng.uniform(-0.35, 0.35, 3)
        law = (rng.uniform(0.7, 1.1), *slope, rng.uniform(-0.3, 0.3))
        half = radius * rng.uniform(0.7, 1, 3)
        material = rng.choice(["polymer", "bone", "water"])
        shapes.append(ball(centre, half, str(material), rotation=turn(rng), density=law))
    return shapes


def sheets(rng):
    """Plates of 0.5 to 5 mm, side by side and tilted, in air."""
    thick = np.array([0.5, 0.8, 1.2, 2.0, 3.2, 5.0]) * rng.uniform(0.9, 1.1, 6)
    rotation = turn(rng)
    shapes = []
    for place, width in zip(np.linspace(-19, 19, 6), rng.permutation(thick), strict=True):
        centre = rotation @ np.array([0, 0, place])
        half = (rng.uniform(10, 18), rng.uniform(10, 18), width / 2)
        shapes.append(Shape(BOX, tuple(centre), half, "aluminium", rotation))
    return shapes


def wires(rng, radii=(0.25, 2.5)):
    """Wires and a plate in all directions, in air."""
    shapes = [Shape(BOX, (0, 0, -18), (16, 16, rng.uniform(*radii)), "aluminium", None)]
    for radius in np.geomspace(radii[0], radii[1], 12):
        middle, direction = rng.uniform(-12, 12, 3), rng.normal(size=3)
        direction *= rng.uniform(10, 16) / np.linalg.norm(direction)
        shapes.append(rod(middle - direction, middle + direction, radius, "aluminium"))
    return shapes


def thin_wires(rng):
    """Wires of 0.5 to 1.6 mm."""
    return wires(rng, (0.25, 0.8))


def lattice(rng):
    """A cubic lattice of rods of 0.6 to 1.6 mm, in air, with gaps."""
    rotation, shapes = turn(rng), []
    places = np.linspace(-15, 15, 4)
    for a in places:
        for b in places:
            for axis in range(3):
                if rng.random() < 0.75:
                    middle, half = np.zeros(3), np.zeros(3)
                    half[axis], middle[(axis + 1) % 3], middle[(axis + 2) % 3] = 17, a, b
                    ends = rotation @ (middle - half), rotation @ (middle + half)
                    shapes.append(rod(*ends, rng.uniform(0.3, 0.8), "aluminium"))
    return shapes


def balls(rng):
    """Balls of 1.4 to 3.2 mm in air."""
    return [
        ball(centre, radius, "bone") for centre, radius in apart(rng, 70, (0.7, 1.6), (24,) * 3)
    ]


def walls(rng):
    """Hollow boxes with walls of 0.5 to 1.5 mm."""
    shapes = []
    for _ in range(4):
        rotation, half = turn(rng), rng.uniform(5, 14, 3)
        thick, centre = rng.uniform(0.5, 1.5), rng.uniform(-9, 9, 3)
        for axis in range(3):
            size = half.copy()
            size[axis] = thick / 2
            for side in (-1, 1):
                away = np.zeros(3)
                away[axis] = side * half[axis]
                place = tuple(centre + rotation @ away)
                shapes.append(Shape(BOX, place, tuple(size), "polymer", rotation))
    return shapes


def board(rng):
    """A circuit board with copper, packages and rows of solder balls."""
    tilt = Rotation.from_euler("xyz", rng.uniform(-25, 25, 3), degrees=True).as_matrix()

    def placed(kind, centre, half, material):
        return Shape(kind, tuple(tilt @ np.asarray(centre, float)), half, material, tilt)

    shapes = [placed(BOX, (0, 0, 0), (25, 21, 0.9), "laminate")]
    shapes += [
        placed(BOX, (rng.uniform(-8, 8), y, 0.95), (rng.uniform(6, 16), 0.4, 0.15), "copper")
        for y in np.arange(-18, 19, 4.5)
    ]
    for x, y in ((-12, 9), (11, -8)):
        shapes.append(placed(BOX, (x, y, 4.4), (8, 8, 1.4), "mould"))
        shapes += [
            placed(ELLIPSOID, (x + i, y + j, 2.0), (0.95, 0.95, 0.95), "solder")
            for i in np.arange(-6, 7, 3.0)
            for j in np.arange(-6, 7, 3.0)
            if rng.random() < 0.92
        ]
    for x, y in ((12, 11), (-14, -11), (-4, -13)):
        shapes.append(placed(CYLINDER, (x, y, 5.0), (2.5, 2.5, 4.1), "aluminium"))
    return shapes


def casting(rng):
    """An aluminium block with bosses, bores and pores."""
    rotation = turn(rng)
    half = np.array([20, 15, 13]) * rng.uniform(0.9, 1.05, 3)
    shapes = [Shape(BOX, (0, 0, 0), tuple(half), "aluminium", rotation)]

    def placed(kind, centre, size, material):
        return Shape(kind, tuple(rotation @ np.asarray(centre, float)), size, material, rotation)

    shapes.append(placed(CYLINDER, (6, 0, 12), (8, 8, 8), "aluminium"))
    shapes.append(placed(CYLINDER, (6, 0, 8), (3.5, 3.5, 14), "air"))
    shapes.append(placed(CYLINDER, (-11, 4, 0), (2, 2, 20), "air"))
    shapes.append(placed(BOX, (-10, -11, 2), (5, 5, 9), "air"))
    pores = apart(rng, 30, (0.4, 2.2), half)
    return [*shapes, *(placed(ELLIPSOID, c, (r, r, r), "air") for c, r in pores)]


def spine(rng):
    """Three vertebrae in muscle, with titanium screws."""
    shapes = [ball((0, 0, 0), (29, 26, 60), "muscle")]
    for level in (-20, 0, 20):
        z = level + rng.uniform(-1, 1)
        body = (rng.uniform(11, 13), rng.uniform(8, 9.5), 7.5)
        shapes.append(Shape(CYLINDER, (0, 5, z), body, "bone"))
        core = tuple(np.array(body) - (1.3, 1.3, 1.0))
        shapes.append(Shape(CYLINDER, (0, 5, z), core, "spongy"))
        shapes.append(ball((0, -9, z), (9, 6, 5), "bone"))
        shapes.append(Shape(CYLINDER, (0, -7, z), (4.5, 3.5, 8.5), "water"))
    for side in (-1, 1):
        for level in (-20, 0) if side < 0 else (0, 20):
            start, end = np.array([9 * side, -17, level]), np.array([4 * side, 7, level])
            shapes.append(rod(start, end, rng.uniform(1.6, 2.2), "titanium"))
            shapes.append(ball(start, 3.0, "titanium"))
    return shapes


def tissue(rng):
    """Soft tissue without bone: fat, muscle, water."""
    shapes = [ball((0, 0, 0), (28, 24, 27), "fat"), ball((0, 0, 0), (25, 20.5, 24), "muscle")]
    for centre, radius in apart(rng, 14, (2, 7), (23, 19, 22)):
        half = radius * rng.uniform(0.6, 1, 3)
        shapes.append(ball(centre, half, str(rng.choice(["fat", "water"])), rotation=turn(rng)))
    return shapes


def foot(rng):
    """Rows of bones in soft tissue within skin."""
    shapes = [ball((0, 0, 0), (20, 27, 14), "fat"), ball((0, 0, 0), (18.5, 25.5, 12.5), "muscle")]
    for x in np.linspace(-12, 12, 5):
        for low, high in ((2, 19 - abs(x) * 0.5), (-9, 0)):
            start = np.array([x * 0.7, low, rng.uniform(-2, 2)])
            end = np.array([x, high, rng.uniform(-2, 2)])
            radius = rng.uniform(1.6, 2.4)
            shapes.append(rod(start, end, radius, "bone", ELLIPSOID if low < 0 else CYLINDER))
            shapes.append(rod(start * 0.97, end * 0.97, radius - 0.8, "spongy"))
    heel = ball((0, -17, 0), (7, 6, 6), "bone"), ball((0, -17, 0), (6, 5, 5), "spongy")
    return [*shapes, *heel]


def tooth(rng):
    """Two teeth with enamel, dentine and pulp, in jaw bone within soft tissue."""
    shapes = [ball((0, 0, 0), (22, 18, 27), "muscle")]
    shapes.append(Shape(BOX, (0, 0, -12), (16, 7, 10), "bone"))
    shapes.append(Shape(BOX, (0, 0, -12), (14.8, 5.8, 9), "spongy"))
    for x in (-7.5, 7.5):
        wide = rng.uniform(5.2, 6.2)
        shapes.append(ball((x, 0, 8), (wide, wide, 7), "enamel"))
        shapes.append(ball((x, 0, 6.5), (wide - 1.2, wide - 1.2, 6.6), "dentine"))
        for side in (-1, 1):
            root = rod((x + 1.5 * side, 0, 4), (x + 3 * side, 0, -16), 2.2, "dentine", ELLIPSOID)
            shapes += [root, rod((x + side, 0, 4), (x + 2.6 * side, 0, -13), 0.6, "muscle")]
        shapes.append(ball((x, 0, 5), (2, 2, 3), "muscle"))
    return shapes


def mixture(rng):
    """Inserts of several materials in a polymer cylinder."""
    shapes = [Shape(CYLINDER, (0, 0, 0), (26, 26, 20), "polymer")]
    names = ["water", "bone", "aluminium", "teflon", "fat", "air", "air", "teflon"]
    for angle, name in zip(np.arange(8) * np.pi / 4, rng.permutation(names), strict=True):
        centre = (16 * np.cos(angle), 16 * np.sin(angle), rng.uniform(-4, 4))
        radius = rng.uniform(2, 5)
        shapes.append(Shape(CYLINDER, centre, (radius, radius, rng.uniform(6, 14)), str(name)))
    for angle, radius in zip(np.arange(5) * 1.257, (0.5, 0.8, 1.2, 2, 3), strict=True):
        shapes.append(ball((6 * np.cos(angle), 6 * np.sin(angle), 0), radius, "aluminium"))
    return shapes


def limb(rng):
    """A limb that goes on above and below the grid."""
    shapes = [Shape(CYLINDER, (0, 0, 0), (25, 22, 90), "muscle")]
    for x, y, radius in ((-8, 2, 7), (10, -4, 4.5)):
        lean = Rotation.from_euler("xy", rng.uniform(-4, 4, 2), degrees=True).as_matrix()
        shapes.append(Shape(CYLINDER, (x, y, 0), (radius, radius, 95), "bone", lean))
        inner = (radius - 1.8, radius - 1.8, 95)
        shapes.append(Shape(CYLINDER, (x, y, 0), inner, "marrow", lean))
    lesions = apart(rng, 6, (1.5, 3.5), (20, 17, 26))
    return [*shapes, *(ball(centre, radius, "fat") for centre, radius in lesions)]


def trunk(rng):
    """A trunk wider and longer than the grid: organs, ribs and a vertebra."""
    shapes = [ball((0, 0, 0), (46, 36, 120), "fat"), ball((0, 0, 0), (43, 33, 118), "muscle")]
    for centre, radius in apart(rng, 10, (4, 11), (38, 28, 40)):
        half = radius * rng.uniform(0.7, 1, 3)
        shapes.append(ball(centre, half, str(rng.choice(["fat", "water"])), rotation=turn(rng)))
    shapes.append(Shape(CYLINDER, (0, -18, 0), (8, 6.5, 90), "bone"))
    shapes.append(Shape(CYLINDER, (0, -18, 0), (6.8, 5.3, 90), "spongy"))
    for z in np.arange(-40, 41, 13.0):
        shapes += [rod((side * 8, -20, z), (side * 36, -6, z - 6), 2.2, "bone") for side in (-1, 1)]
    return shapes
