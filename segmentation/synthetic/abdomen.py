"""The left half of an abdomen in the excretory phase, painted back to front with typical HU.

HU of the tissues: subcutaneous and perirenal fat -105, muscle 58, skin 20, blood 135,
spleen 112, renal cortex 156 and medulla 194, bone 230 (cancellous) to 750 (cortical),
contrast-filled urine 310 to 395 with the denser part lying posteriorly.
"""

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.synthetic.collecting_system import CollectingSystem
from segmentation.synthetic.shapes import Box, Canvas, ellipsoid_level, smooth_curve, smooth_field

AIR, FAT, MUSCLE, SKIN, BLOOD = -1000.0, -105.0, 58.0, 20.0, 135.0
CANCELLOUS, CORTICAL, DISC = 230.0, 750.0, 85.0
CORTEX, MEDULLA, SPLEEN = 156.0, 194.0, 112.0
INF = float("inf")

BODY_CENTER, BODY_RADII = (0.0, -18.0, 0.0), (140.0, 107.0, INF)
KIDNEY_CENTER, KIDNEY_RADII = np.array([63.0, 25.5, 2.0]), np.array([28.0, 22.5, 51.0])
# The upper pole lies medially and posteriorly of the lower one.
KIDNEY_LEAN = np.array([-0.17, 0.12])
VERTEBRA_PITCH, VERTEBRA_CENTER_Y = 35.0, 22.0


def paint_abdomen(canvas: Canvas, system: CollectingSystem, *, rng: np.random.Generator) -> None:
    """Fill the canvas: body wall, muscles, spine, ribs, vessels, bowel, spleen, kidney, urine."""
    spacing = (float(canvas.z[1] - canvas.z[0]), canvas.pixel, canvas.pixel)
    shape = (len(canvas.z), len(canvas.y), len(canvas.x))
    wave = smooth_field(shape, spacing, 26.0, rng=rng)
    _body_wall(canvas, wave)
    _perirenal_fat(canvas, wave)
    _muscles(canvas, wave)
    _bowel(canvas, wave, rng)
    _spleen(canvas, wave)
    _kidney(canvas, system, wave, rng)
    _vessels(canvas, system)
    _spine(canvas, rng)
    _ribs(canvas)
    _urine(canvas, system)


def _common(inner: Box, outer: Box) -> Box:
    """The part of one index box that lies in another."""
    z, y, x = (
        slice(max(i.start, o.start), max(min(i.stop, o.stop), i.start, o.start)) for i, o in zip(inner, outer, strict=True)
    )
    return z, y, x


def _within(inner: Box, outer: Box) -> Box:
    """An index box counted from the corner of the one around it."""
    z, y, x = (slice(i.start - o.start, i.stop - o.start) for i, o in zip(inner, outer, strict=True))
    return z, y, x


def skin_level(x: FloatArray, y: FloatArray) -> FloatArray:
    """Signed distance in mm to the skin, negative inside: an ellipse with a flattened back, furrowed over the spine."""
    oval = ellipsoid_level((x, y, np.zeros(1)), BODY_CENTER, BODY_RADII)
    back = y - 81.0 - 2.5 * np.cos(x / 34.0)
    return np.asarray(0.5 * (oval + back + np.sqrt((oval - back) ** 2 + 6.0**2)))


def _body_wall(canvas: Canvas, wave: FloatArray) -> None:
    everything = canvas.box((-INF,) * 3, (INF,) * 3)
    x, y, _ = canvas.axes()
    skin = skin_level(x, y)  # the same in every slice
    canvas.paint(everything, skin, SKIN)
    canvas.paint(everything, skin + 2.0, FAT)
    depth = -skin[0]
    # Thin septa wander through the subcutaneous fat.
    ring = (depth > 3.0) & (depth < 21.0)
    canvas.hu[:, ring] += 26.0 * np.clip(0.65 - 9.0 * np.abs(wave[:, ring] - 0.35), 0.0, 1.0)
    # The mesentery is not clean fat: vessels too small to see make it hazy along sheets.
    ring = depth > 35.0
    canvas.hu[:, ring] += 24.0 * np.clip(0.7 - 3.0 * np.abs(wave[:, ring] + 0.2), 0.0, 1.0) + 5.0 * wave[:, ring]
    # Three layers of the abdominal wall with fat planes between them; they end at the muscles of the back.
    ring = (depth > 14.0) & (depth < 35.0) & (np.broadcast_to(y[0], depth.shape) < 54.0)
    deep, shift = depth[ring], 0.8 * wave[:, ring]
    part = canvas.hu[:, ring]
    for outer, inner in [(20.0, 25.5), (26.5, 30.0), (31.0, 33.5)]:
        sheet = np.maximum(outer - deep + shift, deep - inner - shift)
        sheet = np.maximum(sheet, np.broadcast_to(y[0], depth.shape)[ring] - 52.0)
        part += np.clip(0.5 - sheet / canvas.pixel, 0.0, 1.0) * (MUSCLE - part)
    canvas.hu[:, ring] = part


def _perirenal_fat(canvas: Canvas, wave: FloatArray) -> None:
    """The fascia around the kidney's fat, a thin line that later paint may hide."""
    reach = KIDNEY_RADII + 16.0
    box = canvas.box(KIDNEY_CENTER - reach, KIDNEY_CENTER + reach)
    level = kidney_level(*canvas.axes(box))
    canvas.paint(box, np.abs(level - 9.0 - 3.0 * wave[box]) - 0.45, -30.0)


def _muscles(canvas: Canvas, wave: FloatArray) -> None:
    # Middle (lateral, posterior) and radii in mm; the psoas begins slender and grows and moves out downward.
    columns = {
        "psoas": (21.0, 28.0, 11.5, 14.0),
        "quadratus": (62.0, 54.5, 22.0, 6.0),
        "medial": (27.0, 64.0, 20.5, 10.5),
        "lateral": (57.0, 64.0, 15.0, 7.0),
    }
    for side in (1.0, -1.0):
        for name, (lateral, posterior, wide, thick) in columns.items():
            moves = 14.0 if name == "psoas" else 0.0
            ends = sorted((side * max(lateral - wide - 4.0, 2.0), side * (lateral + wide + moves + 4.0)))
            box = canvas.box((ends[0], -INF, -INF), (ends[1], INF, INF))
            if box[2].stop <= box[2].start:
                continue
            x, y, z = canvas.axes(box)
            grown = 0.62 + 0.38 / (1.0 + np.exp((z + 22.0) / 14.0)) if moves else np.ones_like(z)
            across = (side * x - lateral - moves * grown) / grown
            level = ellipsoid_level((across, (y - posterior) / grown, np.zeros(1)), (0.0, 0.0, 0.0), (wide, thick, INF))
            canvas.paint(box, level + 1.1 * wave[box], MUSCLE + 4.0 * wave[box])


def _bowel(canvas: Canvas, wave: FloatArray, rng: np.random.Generator) -> None:
    # Descending colon: wall, mottled content, gas that rises to the front.
    path = smooth_curve(
        np.array(
            [
                [103.0, 0.0, -120.0],
                [101.0, 3.0, -60.0],
                [104.0, -2.0, -20.0],
                [101.0, -12.0, 25.0],
                [96.0, -24.0, 70.0],
                [92.0, -30.0, 110.0],
            ]
        ),
        7.0,
    )
    radii = 12.5 + 1.8 * np.sin(np.arange(len(path)) * 1.5)
    box, level = canvas.tube(path, radii, 4.0)
    canvas.paint(box, level, 62.0)
    shape = (level.shape[0], level.shape[1], level.shape[2])
    crumbs = smooth_field(shape, (1.0, canvas.pixel, canvas.pixel), 5.0, rng=rng)
    stool = np.where(crumbs > 0.9, -260.0, 28.0 + 22.0 * crumbs)
    canvas.paint(box, level + 2.4, stool)
    _, y, _ = canvas.axes(box)
    top = np.interp(canvas.z[box[0]], path[:, 2], path[:, 1])[:, None, None] - 4.5
    canvas.paint(box, np.maximum(level + 2.6, y - top + 0.5 * wave[box]), -960.0)
    # Jejunal loops in front of the kidney: enhanced wall with feathery folds, fluid inside.
    for start, bend, end, radius in [
        ([14.0, -36.0, 40.0], [40.0, -42.0, 52.0], [66.0, -34.0, 44.0], 11.0),
        ([70.0, -44.0, 20.0], [44.0, -52.0, 12.0], [18.0, -48.0, 22.0], 11.5),
        ([24.0, -38.0, -12.0], [52.0, -32.0, -18.0], [78.0, -46.0, -8.0], 11.0),
        ([72.0, -30.0, -46.0], [46.0, -40.0, -42.0], [16.0, -34.0, -50.0], 12.0),
        ([-14.0, -44.0, -30.0], [-22.0, -50.0, 4.0], [-10.0, -46.0, 36.0], 11.0),
        ([34.0, -58.0, -72.0], [60.0, -48.0, -80.0], [84.0, -40.0, -72.0], 11.0),
        ([86.0, -62.0, 44.0], [64.0, -70.0, 36.0], [34.0, -68.0, 46.0], 12.0),
        ([88.0, -64.0, -28.0], [84.0, -60.0, -6.0], [88.0, -58.0, 14.0], 12.0),
        ([-6.0, -74.0, -20.0], [26.0, -76.0, -24.0], [56.0, -68.0, -30.0], 12.0),
        ([4.0, -76.0, 12.0], [34.0, -80.0, 6.0], [60.0, -72.0, -4.0], 11.5),
    ]:
        loop = smooth_curve(np.array([start, bend, end]), 7.0)
        box, level = canvas.tube(loop, np.full(len(loop), radius), 4.0)
        shape = (level.shape[0], level.shape[1], level.shape[2])
        folds = smooth_field(shape, (1.0, canvas.pixel, canvas.pixel), 4.5, rng=rng)
        x, y, _ = canvas.axes(box)
        level = np.maximum(level + 1.0 * wave[box], skin_level(x, y) + 35.0)
        canvas.paint(box, level, 92.0)
        canvas.paint(box, level + 2.6 + 0.9 * folds, 24.0 + 12.0 * folds)


def _spleen(canvas: Canvas, wave: FloatArray) -> None:
    center, radii = (92.0, 26.0, 72.0), (25.0, 40.0, 44.0)
    box = canvas.box(
        [c - r - 4.0 for c, r in zip(center, radii, strict=True)], [c + r + 4.0 for c, r in zip(center, radii, strict=True)]
    )
    x, y, z = canvas.axes(box)
    level = np.maximum(ellipsoid_level((x, y, z), center, radii), skin_level(x, y) + 35.0)
    hollow = ellipsoid_level((x, y, z), (62.0, 20.0, 44.0), (31.0, 30.0, 60.0))
    canvas.paint(box, np.maximum(level, -hollow) + 0.8 * wave[box], SPLEEN + 4.0 * wave[box])


def kidney_level(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """About the signed distance in mm to the kidney's capsule, the sinus not taken out."""
    along = z - KIDNEY_CENTER[2]
    oval = ellipsoid_level((x - KIDNEY_LEAN[0] * along, y - KIDNEY_LEAN[1] * along, z), KIDNEY_CENTER, KIDNEY_RADII)
    hilum = ellipsoid_level((x, y, z), (36.0, 15.0, 0.0), (13.0, 11.0, 17.0))
    return np.asarray(0.5 * (oval - hilum + np.sqrt((oval + hilum) ** 2 + 5.0**2)))


def _kidney(canvas: Canvas, system: CollectingSystem, wave: FloatArray, rng: np.random.Generator) -> None:
    reach = KIDNEY_RADII + 18.0
    box = canvas.box(KIDNEY_CENTER - reach, KIDNEY_CENTER + reach)
    x, y, z = canvas.axes(box)
    level = kidney_level(x, y, z) + 1.2 * wave[box]
    size = (level.shape[0], level.shape[1], level.shape[2])
    spacing = (1.0, canvas.pixel, canvas.pixel)
    level += 0.9 * smooth_field(size, spacing, 14.0, rng=rng)  # foetal lobulation
    canvas.paint(box, level - 3.5 - 1.0 * wave[box], FAT)
    fine = smooth_field(size, spacing, 5.0, rng=rng)
    canvas.paint(box, level, CORTEX + 4.0 * fine)
    canvas.paint(box, level + 7.0 + 1.5 * fine, 0.5 * (CORTEX + MEDULLA) + 4.0 * fine, soft=2.0)
    # Pyramids: cones that open from each papilla towards the capsule and stop 4 mm below it.
    for (px, py, pz, radius), direction in zip(system.papillae, system.papilla_axes, strict=True):
        apex = np.array([px, py, pz]) - radius * direction
        inner = _common(canvas.box(apex - 26.0, apex + 26.0), box)
        local = _within(inner, box)
        ox, oy, oz = (axis - c for axis, c in zip(canvas.axes(inner), apex, strict=True))
        along = ox * direction[0] + oy * direction[1] + oz * direction[2]
        across = np.sqrt(np.maximum(ox**2 + oy**2 + oz**2 - along**2, 0.0))
        cone = np.maximum((across - 2.6 - 0.7 * along) / 1.22, -along)
        canvas.paint(inner, np.maximum(cone, level[local] + 4.0 + 0.8 * fine[local]), MEDULLA + 4.0 * fine[local], soft=1.5)
    # Sinus fat around the pelvis and infundibula, open towards the hilum.
    for branch in system.branches:
        trunk = branch.name == "ureter and pelvis"
        if branch.name[-1].isdigit():
            continue
        inside = slice(np.searchsorted(branch.points[:, 2], -26.0), None) if trunk else slice(None, -6)
        points_in, radii = branch.points[inside], branch.radii[inside]
        sinus, depth = canvas.tube(points_in[::3], radii[::3] + (5.5 if trunk else 3.6), 4.0)
        canvas.paint(sinus, depth + 1.8 * wave[sinus], FAT + 12.0, soft=2.0)


def _vessels(canvas: Canvas, system: CollectingSystem) -> None:
    tubes = [
        ([[6.0, -9.0, -140.0], [8.0, -10.0, -60.0], [10.0, -10.0, 0.0], [9.0, -8.0, 120.0]], 9.5, 9.5, BLOOD),  # aorta
        ([[-21.0, -8.0, -140.0], [-22.0, -10.0, 0.0], [-23.0, -14.0, 120.0]], 11.0, 11.0, BLOOD - 8.0),  # vena cava
        (
            [[55.0, 17.0, 6.0], [38.0, 5.0, 9.0], [20.0, -17.0, 9.0], [4.0, -24.0, 8.0], [-16.0, -13.0, 6.0]],
            2.6,
            5.2,
            BLOOD - 6.0,
        ),  # left renal vein
        (
            [[54.0, 20.5, 10.0], [40.0, 12.0, 12.0], [26.0, 1.0, 13.0], [14.0, -8.0, 13.0]],
            1.6,
            2.9,
            BLOOD + 6.0,
        ),  # left renal artery
        (
            [[9.0, -27.0, -140.0], [11.0, -30.0, -40.0], [10.0, -29.0, 20.0], [9.0, -15.0, 42.0]],
            2.6,
            3.6,
            BLOOD,
        ),  # superior mesenteric artery
        (
            [[34.0, -1.0, -140.0], [35.0, 0.0, -60.0], [36.0, 1.0, -10.0], [32.0, -5.0, 8.0]],
            1.7,
            1.9,
            BLOOD - 10.0,
        ),  # gonadal vein
    ]
    for branch in system.branches:
        if branch.name in ("upper", "middle", "lower"):  # segmental vessels run beside the infundibula in the sinus fat
            for beside, hu in [([-2.0, -3.8, 2.4], BLOOD + 6.0), ([2.6, 3.4, 3.0], BLOOD - 4.0)]:
                tubes.append(((branch.points[8:-4:6] + np.array(beside)).tolist(), 1.3, 1.0, hu))
    for k in range(12):  # mesenteric vessels fan out from the root
        tip = [8.0 + 8.5 * k, -62.0 + 14.0 * np.sin(2.3 * k), 60.0 * np.sin(1.7 * k + 0.4)]
        tubes.append(([[10.0, -32.0, 0.45 * tip[2]], [12.0 + 4.0 * k, -46.0, 0.8 * tip[2]], tip], 1.5, 0.7, BLOOD - 15.0))
    for waypoints, first, last, hu in tubes:
        path = smooth_curve(np.array(waypoints), 6.0)
        box, level = canvas.tube(path, np.linspace(first, last, len(path)), 2.0)
        if min(s.stop - s.start for s in box) > 0:
            canvas.paint(box, level, hu)


def _spine(canvas: Canvas, rng: np.random.Generator) -> None:
    reach = 46.0
    box = canvas.box((-reach, VERTEBRA_CENTER_Y - 30.0, -INF), (reach, 84.0, INF))
    x, y, z = canvas.axes(box)
    shape = (len(canvas.z), box[1].stop - box[1].start, box[2].stop - box[2].start)
    trabecula = smooth_field(shape, (1.0, canvas.pixel, canvas.pixel), 3.0, rng=rng)
    phase = np.mod(z + 0.5 * VERTEBRA_PITCH, VERTEBRA_PITCH) - 0.5 * VERTEBRA_PITCH  # mm from a vertebra's middle
    waist = 2.6 * np.cos(np.pi * phase / 27.0) * (np.abs(phase) < 13.5)
    lateral, forward = 24.5 - waist, 17.5 - 0.8 * waist
    oval = ellipsoid_level(
        (x * 24.5 / lateral, (y - VERTEBRA_CENTER_Y) * 17.5 / forward, 0.0 * z), (0.0, 0.0, 0.0), (24.5, 17.5, INF)
    )
    body = np.maximum(np.maximum(oval, y - VERTEBRA_CENTER_Y - 14.0), np.abs(phase) - 13.5)
    canvas.paint(box, np.maximum(oval + 1.5, np.abs(phase) - 17.6), DISC)
    canvas.paint(box, body, CORTICAL - 180.0)
    canvas.paint(box, body + 1.3, CANCELLOUS + 26.0 * trabecula)
    # Canal: epidural fat around the dural sac.
    canvas.paint(box, ellipsoid_level((x, y, 0.0 * z), (0.0, 45.0, 0.0), (11.5, 9.0, INF)), FAT + 20.0)
    canvas.paint(box, ellipsoid_level((x, y, 0.0 * z), (0.0, 44.5, 0.0), (8.5, 6.5, INF)), 28.0)
    levels = VERTEBRA_PITCH * np.arange(np.floor(canvas.z[0] / VERTEBRA_PITCH) - 1, np.ceil(canvas.z[-1] / VERTEBRA_PITCH) + 2)
    for middle in levels:
        for side in (-1.0, 1.0):
            rods = [
                ([[side * 14.0, 34.0, 5.0], [side * 15.5, 46.0, 4.0]], 4.2, 4.0),  # pedicle
                ([[side * 16.0, 47.0, 2.0], [side * 27.0, 49.0, 2.0], [side * 41.0, 48.0, 4.0]], 4.0, 2.6),  # transverse process
                ([[side * 16.5, 48.0, 10.0], [side * 17.0, 51.0, -12.0]], 4.6, 5.0),  # articular processes
                ([[side * 14.0, 51.0, 0.0], [side * 3.0, 57.5, -4.0]], 3.2, 3.2),  # lamina
            ]
            for waypoints, first, last in rods:
                _bone(canvas, np.array(waypoints) + np.array([0.0, 0.0, middle]), first, last)
        for height in (-9.0, -3.0, 3.0):
            _bone(
                canvas, np.array([[0.0, 56.0, middle - 5.0 + height], [0.0, 72.0, middle - 8.0 + height]]), 2.8, 3.6
            )  # spinous process


def _bone(canvas: Canvas, waypoints: FloatArray, first: float, last: float) -> None:
    """A rod with a cortical shell of 1.3 mm."""
    box, level = canvas.tube(waypoints, np.linspace(first, last, len(waypoints)), 1.5)
    if min(s.stop - s.start for s in box) <= 0:
        return
    canvas.paint(box, level, CORTICAL)
    canvas.paint(box, level + 1.4, CANCELLOUS + 110.0)


def _ribs(canvas: Canvas) -> None:
    # They lie in the body wall, 20 mm under the skin, and fall towards the front; the twelfth is short.
    for top, last in [(64.0, 1.62), (36.0, 0.95), (96.0, 1.62)]:
        turn = np.linspace(0.36, last, 7)
        x, y = (BODY_RADII[0] - 22.0) * np.sin(turn), BODY_CENTER[1] + (BODY_RADII[1] - 20.0) * np.cos(turn)
        path = smooth_curve(np.column_stack([x, y, top - 34.0 * (turn - 0.36) ** 1.3]), 4.0)
        for offset in (-2.6, 0.0, 2.6):  # higher than thick
            _bone(canvas, path + np.array([0.0, 0.0, offset]), 3.6, 3.0)


def _urine(canvas: Canvas, system: CollectingSystem) -> None:
    """Wall and contrast-filled lumen; the level is that of the known truth."""
    widest = max(float(branch.radii.max()) for branch in system.branches) + 3.0
    axes = np.concatenate([branch.points for branch in system.branches])
    box = canvas.box(axes.min(axis=0) - widest, axes.max(axis=0) + widest)
    level = np.full(tuple(s.stop - s.start for s in box), 3.0)
    for branch in system.branches:
        inner, tube = canvas.tube(branch.points, branch.radii, 3.0)
        part = level[_within(inner, box)]
        np.minimum(part, tube, out=part)
    for px, py, pz, radius in system.papillae:
        reach = radius + 1.5
        ball = canvas.box((px - reach, py - reach, pz - reach), (px + reach, py + reach, pz + reach))
        part = level[_within(ball, box)]
        np.maximum(part, radius - np.linalg.norm(canvas.points(ball) - (px, py, pz), axis=-1), out=part)
    _, y, _ = canvas.axes(box)
    outside_kidney = canvas.hu[box] < 130.0
    canvas.paint(box, np.where(outside_kidney, level - 0.9, 3.0), 52.0)
    contrast = np.clip(348.0 + 2.5 * (y - 17.0), 310.0, 395.0)
    canvas.paint(box, level, contrast)
