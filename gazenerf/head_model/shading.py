"""Shading by spherical-harmonic light (Ramamoorthi and Hanrahan 2001) and the highlight of the cornea."""

from __future__ import annotations

from typing import Any

import numpy as np

from gazenerf.head_model.eyes import reflecting_normals
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, HeadMesh

ILLUMINATION_SIZE = 27

HIGHLIGHT, SHARPNESS = 0.6, 180.0
"""Linear light that an eye adds where it mirrors the strongest light, and the exponent of Blinn's lobe around it."""

LOBE = np.array([1.0, *[2.0 / 3.0] * 3, *[0.25] * 5])
"""Cosine-lobe factors a_l / pi of bands 0, 1, 2."""


def spherical_harmonics(directions: np.ndarray) -> np.ndarray:
    """The nine real basis functions of bands 0 to 2 at unit directions (..., 3): (..., 9).

    Order: 1; y, z, x; xy, yz, 3z^2 - 1, xz, x^2 - y^2, with their usual constants.
    """
    x, y, z = np.moveaxis(np.asarray(directions), -1, 0)
    return np.stack(harmonic_terms(x, y, z, np.ones_like(x)), axis=-1)


def harmonic_terms(x: Any, y: Any, z: Any, one: Any) -> list[Any]:
    """The nine functions of `spherical_harmonics` of coordinates, numpy arrays or tensors; `one` is 1 of their kind."""
    return [
        0.282095 * one,
        0.488603 * y,
        0.488603 * z,
        0.488603 * x,
        1.092548 * x * y,
        1.092548 * y * z,
        0.315392 * (3.0 * z * z - 1.0),
        1.092548 * x * z,
        0.546274 * (x * x - y * y),
    ]


def irradiance(normals: np.ndarray, illumination: np.ndarray) -> np.ndarray:
    """Irradiance over pi (V, 3) at unit world normals (V, 3) under an illumination code (27,)."""
    coefficients = np.asarray(illumination, dtype=np.float64).reshape(9, 3)
    return np.maximum(spherical_harmonics(normals) @ (LOBE[:, None] * coefficients), 0.0)


def light_code(direction: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """(27,) the code of a distant light: unit direction toward it (3,) and RGB radiance (3,)."""
    return (spherical_harmonics(direction)[:, None] * np.asarray(colour)).reshape(-1)


def dominant_direction(illumination: np.ndarray) -> np.ndarray:
    """(3,) unit direction toward the strongest light, from band 1."""
    band = np.asarray(illumination, dtype=np.float64).reshape(9, 3)[1:4].mean(axis=1)
    direction = np.array([band[2], band[0], band[1]])
    norm = np.linalg.norm(direction)
    return direction / norm if norm > 1e-6 else np.array([0.0, 0.0, 1.0])


def linear_to_srgb(linear: np.ndarray) -> np.ndarray:
    """Linear light to sRGB, both in [0, 1]."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)


def srgb_to_linear(srgb: np.ndarray) -> np.ndarray:
    """sRGB to linear light, both in [0, 1]."""
    srgb = np.clip(srgb, 0.0, 1.0)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def shade(mesh: HeadMesh, illumination: np.ndarray, camera_position: np.ndarray | None = None) -> np.ndarray:
    """Vertex colours of a head.

    Args:
        mesh: Albedo, normals and ambient occlusion are used.
        illumination: (27,).
        camera_position: (3,) world; adds a small highlight on the eyes toward the dominant light.

    Returns:
        (V, 3) float32 sRGB.
    """
    light = irradiance(mesh.normals, illumination)
    if mesh.occlusion is not None:
        light = light * mesh.occlusion[:, None]
    colour = mesh.albedo * light
    if camera_position is not None:
        for part, name, centre in zip((EYE_LEFT, EYE_RIGHT), ("left", "right"), mesh.eye_centres, strict=True):
            eye = np.unique(mesh.part_faces(part))
            axis = mesh.landmarks[f"iris_{name}"] - centre
            places, view = mesh.vertices[eye] - centre, np.asarray(camera_position) - mesh.vertices[eye]
            shine = highlight(places / mesh.eye_radius, axis / np.linalg.norm(axis), view, illumination)
            colour[eye] += shine[:, None]
    return linear_to_srgb(colour).astype(np.float32)


def highlight(places: np.ndarray, axis: np.ndarray, view: np.ndarray, illumination: np.ndarray) -> np.ndarray:
    """Light that an eye mirrors towards a camera (Blinn 1977), from where the light is strongest.

    Args:
        places: (N, 3) on the eye's surface, from its centre, in eyeball radii.
        axis: (3,) unit, where it looks.
        view: (N, 3) from there to the camera, of any length.
        illumination: (27,).

    Returns:
        (N,) linear.
    """
    half = view / np.linalg.norm(view, axis=1, keepdims=True) + dominant_direction(illumination)
    half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
    return HIGHLIGHT * np.maximum((reflecting_normals(places, axis) * half).sum(axis=1), 0.0) ** SHARPNESS


def sample_illumination(rng: np.random.Generator) -> np.ndarray:
    """(27,) a plausible portrait light: soft surround, a key light from the front, a weak fill."""
    surround = rng.uniform(0.3, 0.45) * (1.0 + 0.04 * rng.normal(size=3))
    code = np.zeros((9, 3))
    code[0] = surround / 0.282095
    code = code.reshape(-1)
    side = rng.choice([-1.0, 1.0])
    for strength, yaw, pitch in (
        (rng.uniform(1.0, 1.7), side * rng.uniform(10, 60), rng.uniform(15, 50)),
        (rng.uniform(0.0, 0.5), -side * rng.uniform(30, 90), rng.uniform(-10, 30)),
    ):
        yaw, pitch = np.deg2rad([yaw, pitch])
        direction = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
        colour = strength * (1.0 + np.array([0.06, 0.0, -0.06]) * rng.normal())
        code = code + light_code(direction, colour)
    return code.astype(np.float32)
