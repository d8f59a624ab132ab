"""A minimal writer of OpenStreetMap PBF files for tests: nodes and tagged ways, uncompressed."""

from __future__ import annotations

from pathlib import Path


def _varint(n: int) -> bytes:
    n &= (1 << 64) - 1
    out = bytearray()
    while n > 0x7F:
        out.append(n & 0x7F | 0x80)
        n >>= 7
    return bytes([*out, n])


def _zigzag(n: int) -> bytes:
    return _varint(n << 1 if n >= 0 else (-n << 1) - 1)


def _field(number: int, payload: bytes | int) -> bytes:
    if isinstance(payload, int):
        return _varint(number << 3) + _varint(payload)
    return _varint(number << 3 | 2) + _varint(len(payload)) + payload


def _block(kind: str, payload: bytes) -> bytes:
    blob = _field(1, payload) + _field(2, len(payload))
    header = _field(1, kind.encode()) + _field(3, len(blob))
    return len(header).to_bytes(4, "big") + header + blob


def write_pbf(path: Path, nodes: dict[int, tuple[float, float]], ways: list[tuple[list[int], dict[str, str]]]) -> None:
    """Nodes by id as (longitude, latitude) [deg] and ways as (node ids, tags)."""
    words = [""]

    def word(text: str) -> int:
        if text not in words:
            words.append(text)
        return words.index(text)

    points, lines = b"", b""
    for key, (lon, lat) in sorted(nodes.items()):
        # Granularity: 100 nanodegrees.
        points += _field(
            1,
            _field(1, _zigzag_int(key))
            + _field(8, _zigzag_int(round(lat * 1e7)))
            + _field(9, _zigzag_int(round(lon * 1e7))),
        )
    for k, (refs, tags) in enumerate(ways):
        keys = b"".join(_varint(word(t)) for t in tags)
        values = b"".join(_varint(word(t)) for t in tags.values())
        steps = b"".join(_zigzag(b - a) for a, b in zip([0, *refs[:-1]], refs, strict=True))
        lines += _field(3, _field(1, k + 1) + _field(2, keys) + _field(3, values) + _field(8, steps))
    table = b"".join(_field(1, w.encode()) for w in words)
    data = _field(1, table) + _field(2, points) + _field(2, lines)
    path.write_bytes(_block("OSMHeader", _field(4, b"OsmSchema-V0.6")) + _block("OSMData", data))


def _zigzag_int(n: int) -> int:
    return n << 1 if n >= 0 else (-n << 1) - 1
