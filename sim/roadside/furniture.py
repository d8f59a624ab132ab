"""Street furniture: traffic signs, lamp posts, delineators, guard rail, bins; one small texture for all of it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8

from sim.meshes.solid import Part, box, closed_tube, merged, plain
from sim.textures import Board, Color, noise, to_texture

Array = np.ndarray

_CELL_PX = 256
_COLUMNS, _ROWS = 4, 2
SIGNS = ("limit", "warning", "yield", "stop", "priority", "town", "arrow")
_WHITE = 7
_STEEL = (0.42, 0.43, 0.44)


def sign_atlas(rng: np.random.Generator) -> UInt8[Array, "h w 3"]:
    """Faces of the signs in the order of `SIGNS`, one cell each; the last cell is white."""
    image = np.full((_ROWS * _CELL_PX, _COLUMNS * _CELL_PX, 3), 1.0, np.float32)
    painters = (_limit, _warning, _yield_sign, _stop, _priority, _town, _arrow)
    for k, paint in enumerate(painters):
        r, c = divmod(k, _COLUMNS)
        part = image[r * _CELL_PX : (r + 1) * _CELL_PX, c * _CELL_PX : (c + 1) * _CELL_PX]
        paint(Board(part, (_CELL_PX / 2, _CELL_PX / 2), (_CELL_PX / 2, -_CELL_PX / 2)), rng)
        part *= (1 + 0.03 * noise((_CELL_PX, _CELL_PX), 1.2, rng))[..., None]
    return to_texture(image)


_RED: Color = (0.70, 0.06, 0.07)
_PALE: Color = (0.92, 0.92, 0.90)
_INK: Color = (0.05, 0.05, 0.05)


def _ngon(n: int, radius: float, turn: float) -> Float[Array, "n 2"]:
    a = np.arange(n) * 2 * np.pi / n + turn
    return radius * np.stack([np.cos(a), np.sin(a)], axis=-1)


def _limit(b: Board, rng: np.random.Generator) -> None:
    b.image[:] = _RED
    b.disc((0, 0), 0.78, _PALE)
    b.text(-0.5, 0.36, 0.72, 1.0, str(rng.choice(["30", "50", "70"])), _INK)


def _warning(b: Board, _: np.random.Generator) -> None:
    b.image[:] = _RED
    b.poly(_ngon(3, 0.62, np.pi / 2), _PALE)
    b.poly([(-0.06, 0.25), (0.06, 0.25), (0.03, -0.1), (-0.03, -0.1)], _INK)
    b.disc((0, -0.2), 0.055, _INK)


def _yield_sign(b: Board, _: np.random.Generator) -> None:
    b.image[:] = _RED
    b.poly(_ngon(3, 0.60, -np.pi / 2), _PALE)


def _stop(b: Board, _: np.random.Generator) -> None:
    b.image[:] = _PALE
    b.poly(_ngon(8, 0.95, np.pi / 8), _RED)
    b.text(-0.7, 0.27, 0.54, 1.4, "STOP", _PALE)


def _priority(b: Board, _: np.random.Generator) -> None:
    b.image[:] = _PALE
    b.poly(_ngon(4, 0.62, 0), (0.90, 0.66, 0.05))


def _town(b: Board, rng: np.random.Generator) -> None:
    b.image[:] = (0.90, 0.74, 0.08)
    b.line([(-0.94, -0.9), (0.94, -0.9), (0.94, 0.9), (-0.94, 0.9), (-0.94, -0.9)], 0.04, _INK)
    b.text(-0.8, 0.7, 0.6, 1.6, str(rng.choice(["Neustadt", "Altdorf", "Bergheim", "Seefeld"])), _INK)
    b.text(-0.6, -0.2, 0.35, 1.2, "Kreis Nord", _INK)


def _arrow(b: Board, rng: np.random.Generator) -> None:
    b.image[:] = (0.08, 0.22, 0.58)
    b.text(-0.85, 0.7, 0.5, 1.5, str(rng.choice(["Zentrum", "Hafen", "Messe"])), _PALE)
    b.poly([(-0.6, -0.2), (0.1, -0.2), (0.1, 0.02), (0.7, -0.4), (0.1, -0.8), (0.1, -0.58), (-0.6, -0.58)], _PALE)


def _cell_uv(cell: int, at: Array) -> Array:
    """Texture coordinates of (a, b) in -1..1 on a cell."""
    r, c = divmod(cell, _COLUMNS)
    inset = 0.98 * np.asarray(at, float)
    return np.stack([(c + 0.5 + inset[..., 0] / 2) / _COLUMNS, 1 - (r + 0.5 - inset[..., 1] / 2) / _ROWS], axis=-1)


_WHITE_UV = (0.875, 0.25)


def _shaped(vertices: Array, faces: Array, color: tuple[float, float, float], gloss: float = 0.0) -> Part:
    return plain(vertices, faces, color, gloss, _WHITE_UV)


def _post(
    x: float, y: float, z0: float, z1: float, radius: float, color: tuple[float, float, float], sides: int = 7
) -> Part:
    a = np.arange(sides) * 2 * np.pi / sides
    ring = np.stack([x + radius * np.cos(a), y + radius * np.sin(a), 0 * a], axis=-1)
    return _shaped(*closed_tube(np.stack([ring + np.array([0, 0, z]) for z in (z0, z1)])), color, 0.03)


def _plate(
    outline: Float[Array, "n 2"], cell: int, width: float, height: float, at: tuple[float, float, float]
) -> Part:
    """A sign's plate of 1.5 cm that looks toward -y, outline in -1..1."""
    n = len(outline)
    xz = outline * [width / 2, height / 2]
    front = np.stack([xz[:, 0], np.full(n, -0.06), xz[:, 1]], axis=-1) + at
    vertices, faces = closed_tube(np.stack([front + np.array([0, 0.015, 0]), front]))
    uv = np.broadcast_to(np.asarray(_WHITE_UV), (len(faces), 3, 2)).copy()
    painted = np.append(np.tile(outline, (2, 1)), [[0, 0], [0, 0]], axis=0)
    is_front = np.all((faces >= n) & (faces != 2 * n), axis=1)
    uv[is_front] = _cell_uv(cell, painted[faces[is_front]])
    color = np.where(is_front[:, None], 0.9, 0.3) * np.ones((1, 3))
    return Part(vertices, faces, uv, color, np.full(len(faces), 0.02))


_SQUARE = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])


def sign(kind: str, position: tuple[float, float, float]) -> Part:
    """A traffic sign on its post, facing -y."""
    cell = SIGNS.index(kind)
    outline, width, height, low = {
        "limit": (_ngon(20, 1, 0), 0.6, 0.6, 2.1),
        "warning": (_ngon(3, 1, np.pi / 2), 0.95, 0.95, 2.1),
        "yield": (_ngon(3, 1, -np.pi / 2), 0.95, 0.95, 2.1),
        "stop": (_ngon(8, 0.99, np.pi / 8), 0.8, 0.8, 2.0),
        "priority": (_ngon(4, 1, 0), 0.85, 0.85, 2.1),
        "town": (_SQUARE, 1.6, 0.9, 1.5),
        "arrow": (_SQUARE, 1.5, 0.6, 1.9),
    }[kind]
    x, y, z = position
    middle = z + low + height / 2
    parts = [_plate(outline, cell, width, height, (x, y, middle))]
    posts = (-0.55, 0.55) if width > 1.2 else (0.0,)
    parts += [_post(x + dx, y, z - 0.1, middle + 0.4 * height, 0.035, _STEEL) for dx in posts]
    return merged(parts)


def lamp_post(position: tuple[float, float, float], toward: float) -> Part:
    """A street lamp of 7 m with an arm toward +x or -x."""
    x, y, z = position
    tip = x + toward * 1.4
    arm = _shaped(*box((min(x, tip), y - 0.04, z + 6.85), (max(x, tip), y + 0.04, z + 6.95)), _STEEL, 0.03)
    head = _shaped(*box((tip - 0.35, y - 0.13, z + 6.78), (tip + 0.35, y + 0.13, z + 6.92)), (0.5, 0.5, 0.5), 0.03)
    return merged([_post(x, y, z - 0.1, z + 1.2, 0.09, _STEEL), _post(x, y, z + 1.0, z + 6.9, 0.06, _STEEL), arm, head])


def delineator(position: tuple[float, float, float]) -> Part:
    """A white roadside post with its black band and reflector."""
    x, y, z = position
    return merged([
        _shaped(*box((x - 0.06, y - 0.04, z - 0.05), (x + 0.06, y + 0.04, z + 0.70)), (0.80, 0.80, 0.78)),
        _shaped(*box((x - 0.0605, y - 0.0405, z + 0.70), (x + 0.0605, y + 0.0405, z + 0.95)), (0.03, 0.03, 0.03)),
        _shaped(*box((x - 0.06, y - 0.04, z + 0.95), (x + 0.06, y + 0.04, z + 1.05)), (0.80, 0.80, 0.78)),
        _shaped(*box((x - 0.03, y - 0.047, z + 0.76), (x + 0.03, y + 0.045, z + 0.90)), (0.75, 0.40, 0.10), 0.05),
    ])  # fmt: skip


def guard_rail(x: float, y0: float, y1: float, z: float, toward: float) -> Part:
    """A W-beam on posts along y; its face looks toward +x or -x."""
    depth = [0.00, 0.06, 0.06, 0.01, 0.06, 0.06, 0.00, -0.015, -0.015]
    profile = np.stack([depth, [0.44, 0.50, 0.56, 0.60, 0.64, 0.70, 0.76, 0.76, 0.44]], axis=-1)
    ring = np.stack([x + toward * profile[:, 0], np.zeros(len(profile)), z + profile[:, 1]], axis=-1)
    if toward < 0:
        ring = ring[::-1]
    ys = np.arange(y0, y1 + 4.0, 8.0)
    beam = closed_tube(np.stack([ring + np.array([0, y, 0]) for y in ys])[:, ::-1])
    behind = x - toward * 0.08
    boxes = [
        box((behind - 0.05, y - 0.03, z - 0.1), (behind + 0.05, y + 0.03, z + 0.72))
        for y in np.arange(y0, ys[-1] + 0.1, 4.0)
    ]
    posts = [_shaped(*b, (0.30, 0.30, 0.31)) for b in boxes]
    return merged([_shaped(*beam, (0.45, 0.46, 0.47), 0.04), *posts])


def bin_(position: tuple[float, float, float], color: tuple[float, float, float]) -> Part:
    """A wheeled bin at the house wall."""
    x, y, z = position
    vertices, faces = box((x - 0.29, y - 0.28, z), (x + 0.29, y + 0.28, z + 1.0))
    vertices = np.where(vertices[:, 2:] < z + 0.5, (vertices - [x, y, 0]) * [0.8, 0.8, 1] + [x, y, 0], vertices)
    lid = box((x - 0.32, y - 0.32, z + 1.0), (x + 0.32, y + 0.32, z + 1.07))
    return merged([_shaped(vertices, faces, color), _shaped(*lid, (0.05, 0.05, 0.05), 0.03)])
