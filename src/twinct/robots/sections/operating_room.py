"""The operating room (``cell.room: operating``) as objects around the isocentre.

Its walls stand behind and to the left of the camera's view, so that pictures show the whole room.
Sizes are those of common furniture; the table follows the section ``cell.table``.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from math import atan2, degrees
from typing import Any

from twinct.specimen.sections.room_objects import Group, RoomObject

MATTRESS_MM = 40.0
"""Thickness of the mattress, whose upper face is ``cell.table.top_z_mm``."""

HEAD_SHARE = 0.35
"""Share of the table's length on the -y side of the isocentre."""

COLUMN_SHARE = 0.45
"""Distance of the column from the isocentre along y, as a share of the table's length."""

WALL_MM, CEILING_MM = 2600.0, 2900.0
"""Distance of the walls from the isocentre, and height of the room."""

SANDWICH = {"mass_fractions": {"C": 1.0}, "density_g_cm3": 0.10}
"""Table top: two 1 mm skins of carbon fibre (1.6 g/cm3) on foam, averaged over 50 mm."""

FOAM = {"mass_fractions": {"C": 0.63, "H": 0.09, "N": 0.06, "O": 0.22}, "density_g_cm3": 0.05}
"""Mattress of polyurethane foam."""

STEEL, DARK, WHITE, GREY = "#b4bbc0", "#23282d", "#d9dfe2", "#8c979f"
CLOTH, FOLD, SCREEN, LIGHT = "#2c7f86", "#256c73", "#2f6f9f", "#fff7d8"
WALL, PANEL, DOOR, FREE = "#cfdad8", "#9dbab4", "#b3c0c3", "#3fae741c"

Pair = tuple[float, float]
Triple = tuple[float, float, float]


@cache
def operating_room(
    floor_z_mm: float, top_z_mm: float, size_mm: Triple, moved_mm: Pair = (0, 0), *, table: bool
) -> tuple[RoomObject, ...]:
    """Return the objects of the room.

    Args:
        floor_z_mm: height of the floor.
        top_z_mm: height of the mattress's upper face.
        size_mm: width, length and thickness of the table's top plate.
        moved_mm: shift of the table along x, y.
        table: whether there is a table, with its drapes.
    """
    objects = [*_walls(floor_z_mm), *_lamp(floor_z_mm), *_anaesthesia(floor_z_mm)]
    objects += [*_trolley(floor_z_mm), *_staff(floor_z_mm)]
    if table:
        objects += [_moved(one, moved_mm) for one in _table(floor_z_mm, top_z_mm, size_mm)]
    return tuple(objects)


def plate_middle_mm(length_mm: float) -> float:
    """Return the place along y of the middle of a table's plate, before it is moved."""
    return (0.5 - HEAD_SHARE) * length_mm


def _moved(one: RoomObject, by_mm: Pair) -> RoomObject:
    x, y, z = one.position_mm
    return one.model_copy(update={"position_mm": (x + by_mm[0], y + by_mm[1], z)})


def _shape(
    name: str,
    shape: dict[str, Any],
    at: Triple,
    colour: str,
    turned: Triple = (0, 0, 0),
    **more: Any,
) -> RoomObject:
    data = {"name": name, "shape": shape, "position_mm": at, "rotation_deg": turned}
    return RoomObject.model_validate({**data, "colour": colour, **more})


def _box(name: str, size: Triple, at: Triple, colour: str, **more: Any) -> RoomObject:
    return _shape(name, {"kind": "box", "size_mm": size}, at, colour, **more)


def _rod(
    name: str, radius: float, height: float, at: Triple, colour: str, **more: Any
) -> RoomObject:
    shape = {"kind": "cylinder", "radius_mm": radius, "height_mm": height}
    return _shape(name, shape, at, colour, **more)


def _table(floor: float, top: float, size: Triple) -> Iterator[RoomObject]:
    """Yield the operating table; the beam sees its plate and its mattress."""
    width, length, thick = size
    middle, foot = plate_middle_mm(length), (1 - HEAD_SHARE) * length
    plate, column = top - MATTRESS_MM - thick, COLUMN_SHARE * length
    yield _box(
        "table plate",
        (width, length, thick),
        (0, middle, plate + thick / 2),
        DARK,
        material=SANDWICH,
    )
    soft = (width - 16, length - 16, MATTRESS_MM)
    yield _box("mattress", soft, (0, middle, top - MATTRESS_MM / 2), "#31373d", material=FOAM)
    for side, x in (("left", -1), ("right", 1)):
        rail = (0.4 * length, column, plate + thick / 2)
        at = (x * (width / 2 + 14), rail[1], rail[2])
        yield _box(f"table rail, {side}", (12, rail[0], 28), at, STEEL)
    yield _box("table head", (0.7 * width, 0.22 * length, 70), (0, column, plate - 35), GREY)
    height = plate - 70 - floor - 130
    for index, (share, thickness) in enumerate(((0.40, 190), (0.35, 230), (0.25, 270))):
        below = sum((0.25, 0.35, 0.40)[: 2 - index])
        at = (0, column, floor + 130 + (below + share / 2) * height)
        yield _box(f"table column, {index}", (thickness, thickness + 60, share * height), at, STEEL)
    yield _box("table foot", (0.9 * width, 640, 90), (0, column - 40, floor + 75), WHITE)
    yield _box("table plinth", (0.8 * width, 560, 30), (0, column - 40, floor + 15), DARK)
    yield from _drapes(top, width, foot, length)


def _drapes(top: float, width: float, foot: float, length: float) -> Iterator[RoomObject]:
    """Yield a cloth over the foot of the table, with hanging sides."""
    long, group = 0.28 * length, "patient"  # it may cover legs
    y = foot - long / 2
    yield _box("drape", (width + 44, long, 10), (0, y, top + 5), CLOTH, group=group)
    for side, x in (("left", -1), ("right", 1)):
        at = (x * (width / 2 + 30), y, top - 150)
        yield _box(f"drape, {side}", (8, long, 320), at, FOLD, group=group)
    yield _box("drape, end", (width + 44, 8, 380), (0, foot + 6, top - 180), FOLD, group=group)


def _lamp(floor: float) -> Iterator[RoomObject]:
    """Yield two lamp heads on arms from the ceiling."""
    ceiling = floor + CEILING_MM
    yield _rod("lamp mount", 130, 60, (0, 900, ceiling - 30), WHITE)
    yield _rod("lamp post", 38, 420, (0, 900, ceiling - 270), WHITE)
    for name, x, y, z, tilt in (("left", -620, 560, 1010, 16), ("right", 640, 620, 1090, -16)):
        turned = (16, tilt, 0)
        yield _rod(f"lamp {name}", 300, 80, (x, y, z), WHITE, turned=turned)
        yield _rod(f"lamp {name}, light", 265, 10, (x, y, z - 42), LIGHT, turned=turned)
        yield _rod(f"lamp {name}, handle", 22, 130, (x, y, z - 90), GREY)
        reach = float((x * x + (900 - y) ** 2) ** 0.5)
        yield _shape(
            f"lamp {name}, arm",
            {"kind": "box", "size_mm": (reach, 60, 50)},
            (x / 2, (900 + y) / 2, ceiling - 480),
            WHITE,
            turned=(0, 0, _heading(x, y - 900)),
        )
        drop = ceiling - 480 - z
        yield _rod(f"lamp {name}, drop", 26, drop, (x, y, z + drop / 2), WHITE)


def _heading(x: float, y: float) -> float:
    """Return the direction of (x, y), in deg from the x axis."""
    return degrees(atan2(y, x))


def _anaesthesia(floor: float) -> Iterator[RoomObject]:
    """Yield the anaesthesia machine at the head of the table, on the left of the picture."""
    x, y = -1750.0, -700.0
    yield _box("anaesthesia base", (640, 620, 110), (x, y, floor + 95), DARK)
    yield _box("anaesthesia cart", (600, 560, 700), (x, y, floor + 500), WHITE)
    for row in range(3):
        at = (x + 303, y, floor + 270 + 190 * row)
        yield _box(f"anaesthesia drawer {row}", (8, 500, 160), at, "#d5dcdf")
        yield _box(
            f"anaesthesia handle {row}", (14, 220, 18), (x + 312, y, floor + 300 + 190 * row), GREY
        )
    yield _box("anaesthesia desk", (680, 600, 40), (x + 40, y, floor + 870), "#d5dcdf")
    yield _box("anaesthesia back", (180, 560, 620), (x - 190, y, floor + 1200), WHITE)
    for side, dy in (("left", -140), ("right", 140)):
        colour = ("#d8a33a", "#a04fa0")[dy > 0]
        yield _box(
            f"vaporiser, {side}", (110, 110, 210), (x - 40, y + dy / 1.2, floor + 1080), colour
        )
        screen = (x - 20, y + dy * 1.25, floor + 1590)
        yield _box(f"monitor, {side}", (45, 330, 260), screen, DARK)
        at = (screen[0] + 25, screen[1], screen[2])
        yield _box(f"screen, {side}", (6, 300, 225), at, SCREEN)
    yield _rod("monitor post", 28, 300, (x - 120, y, floor + 1560), GREY)
    yield _rod("bellows", 75, 220, (x + 190, y - 190, floor + 1000), "#cfe4ea99")
    bag = {"kind": "capsule", "radius_mm": 70, "length_mm": 140}
    yield _shape("breathing bag", bag, (x + 420, y + 190, floor + 780), "#2d6f5a")
    yield _rod("oxygen bottle", 80, 700, (x - 130, y - 400, floor + 390), WHITE)
    cap = {"kind": "sphere", "radius_mm": 80}
    yield _shape("oxygen bottle, top", cap, (x - 130, y - 400, floor + 740), "#f4f6f6")


def _trolley(floor: float) -> Iterator[RoomObject]:
    """Yield a trolley with instruments."""
    x, y = -1550.0, 1500.0
    yield _box("trolley top", (900, 560, 25), (x, y, floor + 900), STEEL)
    yield _box("trolley cloth", (930, 590, 14), (x, y, floor + 920), CLOTH)
    yield _box("trolley cloth, front", (930, 10, 260), (x, y - 295, floor + 790), FOLD)
    yield _box("trolley shelf", (860, 520, 18), (x, y, floor + 330), STEEL)
    for index, (dx, dy) in enumerate(((-420, -250), (420, -250), (-420, 250), (420, 250))):
        yield _rod(f"trolley leg {index}", 16, 890, (x + dx, y + dy, floor + 445), STEEL)
    yield _box("instrument tray", (420, 300, 40), (x - 120, y, floor + 947), STEEL)
    yield _rod("bowl", 90, 70, (x + 250, y + 40, floor + 962), STEEL)


def _staff(floor: float) -> Iterator[RoomObject]:
    """Yield the places that belong to the staff."""
    group: Group = "staff"
    for name, x, y, wide in (("surgeon", 1650, 1250, 620), ("anaesthetist", -1250, -1450, 620)):
        at = (x, y, floor + 900)
        yield _rod(f"staff zone, {name}", wide / 2, 1790, at, FREE, group=group)
        yield _rod(
            f"staff place, {name}", wide / 2, 4, (x, y, floor + 2), "#3fae74", group=group,
            collides=False,
        )  # fmt: skip


def _walls(floor: float) -> Iterator[RoomObject]:
    """Yield two walls with panels, a door, a window and a screen."""
    far, high = WALL_MM, CEILING_MM
    middle = floor + high / 2
    yield _box("wall, back", (2 * far + 200, 100, high), (0, far + 60, middle), WALL)
    yield _box("wall, left", (100, 2 * far + 200, high), (-far - 60, 0, middle), WALL)
    yield _box("panel, back", (2 * far, 14, 1100), (0, far, floor + 650), PANEL)
    yield _box("panel, left", (14, 2 * far, 1100), (-far, 0, floor + 650), PANEL)
    yield _box("skirting, back", (2 * far, 24, 100), (0, far, floor + 50), GREY)
    yield _box("skirting, left", (24, 2 * far, 100), (-far, 0, floor + 50), GREY)
    yield _box("door", (60, 1300, 2150), (-far, 1150, floor + 1075), DOOR)
    yield _box("door, gap", (66, 14, 2140), (-far, 1150, floor + 1072), GREY)
    for side, dy in (("left", -330), ("right", 330)):
        at = (-far + 8, 1150 + dy, floor + 1500)
        yield _box(f"door, window {side}", (56, 300, 520), at, "#8fb4c4")
    yield _box("wall screen", (1500, 60, 860), (900, far - 40, floor + 1750), DARK)
    yield _box("wall screen, image", (1440, 8, 800), (900, far - 74, floor + 1750), SCREEN)
    yield _box("light box", (760, 50, 520), (-900, far - 30, floor + 1750), "#dfe9ef")
