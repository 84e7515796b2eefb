"""Sparse extraction of face and eyes against dense grids: queries, seconds, memory, and whether it is the same surface.

    python -m benchmarks.mesh --out mesh.json

Where the dense grid is feasible both are sampled in turn in one process and their surfaces compared.
At larger sizes the dense time is the rate measured at the largest such size times the grid's points.
`extract` is everything: where the eyes are, the choice of the threshold, both parts, cleaning and
normals, each size in a process of its own for its peak memory; dense is the sampling alone. Seconds
are the processor's, all threads together, so that other work on the machine counts little.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from scipy.spatial import KDTree

from gazenerf.export import MeshOptions, extract_part
from gazenerf.export.mesh.cleaning import keep_largest
from gazenerf.export.mesh.triangles import pieces
from gazenerf.export.surface.densities import DensityGrid, sample_density
from gazenerf.export.surface.density_surface import KEPT_COMPONENTS, part_box
from gazenerf.export.surface.isosurface import isosurface
from gazenerf.export.surface.refine import refine_density
from gazenerf.files import whole_file
from gazenerf.geometry import Gaze
from gazenerf.heads.interface import BoundField, Part
from gazenerf.loading import load

PARTS: tuple[Part, ...] = ("face", "eyes")
SAME = 1e-5
"""World units that vertices of the same surface may lie apart."""


def compare(bound: BoundField, part: Part, resolution: int, level: float) -> dict[str, Any]:
    """A part's grid, sparse and dense in turn, and how far the vertices of their surfaces are apart.

    Raises:
        AssertionError: the surfaces differ.
    """
    box, _ = part_box(bound, part)
    started = time.process_time()
    refined = refine_density(bound, part, box, resolution, (level, level))
    between = time.process_time()
    dense = sample_density(bound, part, box, resolution)
    ended = time.process_time()
    apart = _apart(*(_kept(grid, level, part) for grid in (dense, refined)))
    assert apart <= SAME, f"the surfaces of the {part} at {resolution} lie {apart:g} units apart"
    return {
        "queries": refined.queries,
        "dense_queries": dense.queries,
        "seconds": between - started,
        "dense_seconds": ended - between,
        "times_fewer": dense.queries / refined.queries,
        "times_faster": (ended - between) / (between - started),
        "vertices_apart": apart,
    }


def _kept(grid: DensityGrid, level: float, part: Part) -> trimesh.Trimesh:
    return keep_largest(isosurface(grid, level), KEPT_COMPONENTS[part])


def _apart(a: trimesh.Trimesh, b: trimesh.Trimesh) -> float:
    """Largest distance from a vertex of one mesh to the nearest of the other; inf where counts differ."""
    if len(a.vertices) != len(b.vertices) or len(a.faces) != len(b.faces):
        return float("inf")
    ways = ((a, b), (b, a))
    return float(max(KDTree(there.vertices).query(here.vertices)[0].max() for here, there in ways))


def extract(bound: BoundField, resolution: int, threshold: str | float = "auto") -> dict[str, Any]:
    """Both parts, everything but colours: queries, points of the same grids, seconds, peak, what came out."""
    meshes, seconds = {}, {}
    options = MeshOptions(resolution=resolution, threshold=threshold, colours=False)
    for part in PARTS:
        started = time.process_time()
        meshes[part] = extract_part(bound, part, options)
        seconds[part] = time.process_time() - started
    found: dict[str, Any] = {"peak_bytes": peak_bytes()}
    for part, got in meshes.items():
        assert got.threshold is not None
        found[part] = {
            "seconds": seconds[part],
            "queries": got.queries,
            "dense_queries": int(np.prod(got.grid)),
            "threshold": got.threshold.level,
            "vertices": len(got.mesh.vertices),
            "components": int(pieces(got.mesh).max()) + 1,
            "watertight": bool(got.mesh.is_watertight),
            "self_intersecting_faces": got.self_intersections,
        }
    return found


def exponent(resolutions: Sequence[int], queries: Sequence[int]) -> float:
    """Slope of log queries over log resolution."""
    return float(np.polyfit(np.log(resolutions), np.log(queries), 1)[0])


def peak_bytes() -> int:
    """Largest resident size of this process so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _bind(args: argparse.Namespace) -> BoundField:
    return load(args.subject, args.checkpoint).at(Gaze())


def _in_a_process(args: argparse.Namespace, size: int) -> dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks.mesh", "--alone", str(size)]
    for name in ("checkpoint", "subject"):
        if (value := getattr(args, name)) is not None:
            command += [f"--{name}", str(value)]
    return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.splitlines()[-1])


def summed(whole: dict[str, Any], rates: dict[Part, float]) -> dict[str, Any]:
    """What `extract` found for both parts together, against dense sampling at rates (points per second)."""
    seconds = sum(whole[part]["seconds"] for part in PARTS)
    queries, points = (sum(whole[part][name] for part in PARTS) for name in ("queries", "dense_queries"))
    guessed = sum(whole[part]["dense_queries"] / rates[part] for part in PARTS)
    return {
        "queries": queries,
        "dense_queries": points,
        "seconds": seconds,
        "times_fewer": points / queries,
        "dense_seconds_from_rate": guessed,
        "times_faster_from_rate": guessed / seconds,
    }


def _print_pair(part: Part, size: int, row: dict[str, Any]) -> None:
    print(
        f"{part} at {size}: {row['times_fewer']:.1f} times fewer queries, {row['times_faster']:.1f} times less time, "
        f"same surface (vertices {row['vertices_apart']:.1g} units apart)"
    )


def _print_extract(size: int, whole: dict[str, Any], both: dict[str, Any], rate_at: int) -> None:
    print(
        f"extract at {size}: {both['queries']:,} of {both['dense_queries']:,} points "
        f"({both['times_fewer']:.1f} times fewer), {both['seconds']:.1f} s; dense sampling "
        f"{both['dense_seconds_from_rate']:.0f} s from its rate at {rate_at} "
        f"({both['times_faster_from_rate']:.1f} times), peak {whole['peak_bytes'] / 2**30:.2f} GiB"
    )
    for part in PARTS:
        got = whole[part]
        closed = "watertight" if got["watertight"] else "open"
        print(
            f"  {part}: {got['vertices']:,} vertices, {got['components']} component(s), {closed}, "
            f"self-intersecting faces: {got['self_intersecting_faces']}"
        )


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", type=Path, help="default: the bundled field")
    parser.add_argument("--subject", help="default: the first bundled one")
    parser.add_argument("--resolutions", type=int, nargs="+", default=[128, 256, 512])
    parser.add_argument("--dense-up-to", type=int, default=192, help="largest size that is sampled densely, too")
    parser.add_argument("--out", type=Path, help="JSON")
    parser.add_argument("--alone", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.alone is not None:
        print(json.dumps(extract(_bind(args), args.alone)))
        return
    sizes = sorted(set(args.resolutions))
    whole = {size: _in_a_process(args, size) for size in sizes}
    bound = _bind(args)
    bound.density(torch.zeros(1, 3))  # so that neither side pays for what the first query prepares
    paired = {}
    for size in [size for size in sizes if size <= args.dense_up_to] or [min(args.dense_up_to, sizes[0])]:
        levels = whole[size if size in whole else sizes[0]]
        paired[size] = {part: compare(bound, part, size, levels[part]["threshold"]) for part in PARTS}
        for part in PARTS:
            _print_pair(part, size, paired[size][part])
    rate_at = max(paired)
    rates = {part: row["dense_queries"] / row["dense_seconds"] for part, row in paired[rate_at].items()}
    both = {size: summed(whole[size], rates) for size in sizes}
    for size in sizes:
        _print_extract(size, whole[size], both[size], rate_at)
    slope = exponent(sizes, [both[size]["queries"] for size in sizes]) if len(sizes) > 1 else None
    if slope is not None:
        print(f"queries grow with the resolution to the power {slope:.2f}; dense 3")
    about = {
        "weights_hash": bound.weights_hash,
        "threads": torch.get_num_threads(),
        "machine": platform.machine(),
        "torch": torch.__version__,
        "dense_rate_at": rate_at,
    }
    rows = {size: {"extract": whole[size], "both": both[size]} for size in sizes}
    if args.out is not None:
        with whole_file(args.out) as temporary:
            temporary.write_text(
                json.dumps(about | {"exponent": slope, "paired": paired, "resolutions": rows}, indent=2)
            )


if __name__ == "__main__":
    main()
