"""The smallest ONNX file that onnxruntime runs, written by hand: the `onnx` package is not needed for it."""

from __future__ import annotations

FLOAT, OPSET = 1, 13


def _number(field: int, value: int) -> bytes:
    return bytes([field << 3]) + _varint(value)


def _text(field: int, value: bytes | str) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return bytes([field << 3 | 2]) + _varint(len(data)) + data


def _varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def _value(name: str, shape: tuple[int, ...]) -> bytes:
    dimensions = b"".join(_text(1, _number(1, side)) for side in shape)
    return _text(1, name) + _text(2, _text(1, _number(1, FLOAT) + _text(2, dimensions)))


def mean_network(side: int = 112, channels: int = 3) -> bytes:
    """A network whose output (1, channels, 1, 1) is the mean of each channel of its input (1, channels, side, side)."""
    node = _text(1, "x") + _text(2, "y") + _text(4, "GlobalAveragePool")
    graph = _text(1, node) + _text(2, "means")
    graph += _text(11, _value("x", (1, channels, side, side))) + _text(12, _value("y", (1, channels, 1, 1)))
    return _number(1, 8) + _text(7, graph) + _text(8, _text(1, "") + _number(2, OPSET))
