"""tubeplan bench matrix: ten instruments against the ten calyces of a renal tree, and random catalogues."""

# Strategy: the tree is generated, so that every calyx and the radius of its neck are known. The catalogue is the one that
# ships. Random catalogues hold instruments, some of them stiffer than the tree's bends, and, of each, neighbours that are
# thinner, more flexible, shorter of tip or longer: none of them may lose what the harder one has, nor be kept out by a proof
# that does not keep out the harder one.

from __future__ import annotations

import os
import resource
import time

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.bench.trees import TreeModel, calyceal_tree, renal_tree
from tubeplan_viz.centerline import Endpoint, voronoi_graph
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.instruments import Instrument, Matrix, ReachSettings, Verdict, find_targets, instrument_matrix, read_catalogue
from tubeplan_viz.pipeline import Notify

SECONDS = 20.0
CATALOGUES, QUICK_CATALOGUES = 4, 1
DRAWN = 6
# Diameter, bend radius, rigid tip and working length, mm.
LEAST, MOST = (0.8, 4.0, 0.0, 150.0), (4.6, 60.0, 9.0, 260.0)


def matrix(*, quick: bool, notify: Notify) -> list[Row]:
    """Time and verdicts of the shipped catalogue on ten calyces; monotony over random catalogues.

    Parameters
    ----------
    quick : bool
        One random catalogue instead of four.
    notify : Notify
    """
    notify("10 instruments, 10 calyces", 0, 0)
    tree = calyceal_tree()
    rows = timed_rows(tree)
    small, rng = prepared(renal_tree()), np.random.default_rng(5)
    broken = pairs = bent = 0
    catalogues = QUICK_CATALOGUES if quick else CATALOGUES
    for number in range(catalogues):
        notify("random catalogues", number, catalogues)
        found = judged(*small, random_catalogue(rng), jobs=1)
        lost, compared = losses(found)
        broken, pairs = broken + lost, pairs + compared
        bent += sum(cell.bend is not None for row in found.cells for cell in row)
    case = f"renal tree, {catalogues} random catalogues of {3 * DRAWN} instruments"
    return [
        *rows,
        Row(case=case, figure="an easier instrument with the worse verdict", ours=broken, target="0", holds=broken == 0),
        Row(
            case=case,
            figure="comparable pairs of cells",
            ours=pairs,
            target="enough to see one: over 100",
            holds=quick or pairs > 100,
        ),
        Row(
            case=case,
            figure="cells that a bend proves impossible",
            ours=bent,
            target="enough to see one: over 10",
            holds=bent > 10,
        ),
    ]


Prepared = tuple[WallDistance, FloatArray, tuple[Endpoint, ...], ReachSettings]


def prepared(tree: TreeModel) -> Prepared:
    """Wall, start and goals of a tree, its tips labelled in their order."""
    goals = tuple(
        Endpoint(
            label=f"E{number + 2}",
            point=point,
            radius=tree.branches[leaf].radius,
            branch_length=tree.branches[leaf].axis.length,
            confidence=1.0,
            cap=None,
        )
        for number, (leaf, point) in enumerate(zip(tree.leaves, tree.targets, strict=True))
    )
    return WallDistance(tree.surface), tree.root, goals, ReachSettings()


def judged(
    wall: WallDistance,
    start: FloatArray,
    goals: tuple[Endpoint, ...],
    settings: ReachSettings,
    instruments: tuple[Instrument, ...],
    *,
    jobs: int,
) -> Matrix:
    """The whole matrix, from the wall on."""
    targets = find_targets(wall, voronoi_graph(wall.surface, wall), start, goals, settings)
    return instrument_matrix(wall, start, targets, instruments, settings, jobs=jobs)


def timed_rows(tree: TreeModel) -> list[Row]:
    """The shipped catalogue: once in this process for its processor time, once on two processes for the clock."""
    ready, instruments = prepared(tree), read_catalogue()
    begun = time.process_time()
    found = judged(*ready, instruments, jobs=1)
    seconds = time.process_time() - begun
    jobs = min(2, os.cpu_count() or 1)
    begun, used = time.perf_counter(), processor_seconds()
    again = judged(*ready, instruments, jobs=jobs)
    clock, used = time.perf_counter() - begun, processor_seconds() - used
    case = f"renal tree, {len(tree.surface.faces)} faces: {len(instruments)} instruments, {len(tree.leaves)} calyces"
    same = all(
        [(a.verdict, a.margin) for a in one] == [(b.verdict, b.margin) for b in two]
        for one, two in zip(found.cells, again.cells, strict=True)
    )
    necks = [tree.branches[leaf].radius for leaf in tree.leaves]
    above = max(target.ceiling.bound - neck for target, neck in zip(found.targets, necks, strict=True))
    false = sum(
        cell.verdict is Verdict.FEASIBLE and one.radius > neck
        for one, row in zip(instruments, found.cells, strict=True)
        for cell, neck in zip(row, necks, strict=True)
    )
    return [
        # The clock of a machine that does nothing else: what both processes use, start-up included, shared between them.
        Row(
            case=case,
            figure=f"processor time s on each of {jobs} processes",
            ours=used / jobs,
            target=f"at most {SECONDS:g}",
            holds=used / jobs <= SECONDS,
        ),
        Row(case=case, figure="processor time s, all in one process", ours=seconds),
        Row(case=case, figure=f"on the clock s, {jobs} processes, beside what else runs", ours=clock),
        Row(case=case, figure="two processes say the same", ours=same, target="1", holds=same),
        Row(
            case=case,
            figure="ceiling of a calyx above the radius of its neck mm, largest",
            ours=above,
            source="model",
            target="at most 0: the mesh is not wider than the neck",
            holds=above <= 0.0,
        ),
        Row(case=case, figure="yes for an instrument thicker than the neck", ours=false, target="0", holds=false == 0),
        *(Row(case=case, figure=f"cells {verdict}", ours=found.count(verdict)) for verdict in Verdict),
    ]


def processor_seconds() -> float:
    """Processor time of this process and of those that it has waited for, s."""
    own, others = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime


def random_catalogue(rng: np.random.Generator) -> tuple[Instrument, ...]:
    """Instruments drawn at random, and of each two neighbours that can take every shape it can."""
    drawn = rng.uniform(LEAST, MOST, (DRAWN, 4))
    shares = rng.uniform(0.6, 1.0, (2, DRAWN, 4))
    shares[..., 3] = 1.0 / shares[..., 3]
    # Each neighbour is easier in some of its values, at random, and alike in the others.
    easier = np.where(rng.random((2, DRAWN, 4)) < 0.5, drawn * shares, drawn)
    return tuple(
        Instrument(
            name=f"{group} {k}",
            kind="random",
            outer_diameter_mm=float(row[0]),
            bend_radius_min_mm=float(row[1]),
            rigid_tip_mm=float(row[2]),
            working_length_mm=float(row[3]),
        )
        for group, rows in (("drawn", drawn), ("easier", easier[0]), ("easier still", easier[1]))
        for k, row in enumerate(rows)
    )


def losses(found: Matrix) -> tuple[int, int]:
    """Pairs of cells in which the easier instrument has the worse verdict, and all pairs that can be compared."""
    lost = compared = 0
    for i, easy in enumerate(found.instruments):
        for k, hard in enumerate(found.instruments):
            if i == k or not easy.is_no_harder_than(hard):
                continue
            for mine, other in zip(found.cells[i], found.cells[k], strict=True):
                compared += 1
                lost += other.verdict is Verdict.FEASIBLE and mine.verdict is not Verdict.FEASIBLE
                lost += mine.verdict is Verdict.IMPOSSIBLE and other.verdict is not Verdict.IMPOSSIBLE
    return lost, compared
