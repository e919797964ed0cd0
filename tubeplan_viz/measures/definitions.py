"""What each measure means, in which unit, and who defined it."""

from __future__ import annotations

from dataclasses import dataclass

from tubeplan_viz.measures.balls import PLATEAU
from tubeplan_viz.measures.pelvis import NECK

ELBAHNASY = "Elbahnasy AM et al., J Urol 1998; 159(3): 676-682"
BULLITT = "Bullitt E et al., IEEE Trans Med Imaging 2003; 22(9): 1163-1171 (distance metric)"
WEIBEL = "Weibel ER, Morphometry of the Human Lung, Springer 1963 (generations counted from the trachea)"
TAWHAI = "Tawhai MH et al., J Appl Physiol 2004; 97(6): 2310-2321 (branching angle)"
OWN = "Definition of this program"
EDGE = (
    "In a CT the outline is where the grey is half way between what fills the lumen and its wall (50 HU, brighter tissue beyond "
    "it, or what is left of the thin wall of an airway), less what blur does to a round lumen; in a mesh it is the mesh."
)


@dataclass(frozen=True, kw_only=True)
class Definition:
    """One kind of measure.

    Attributes
    ----------
    key : str
        Its name in result.json.
    group : {"path", "urinary", "airway", "stone", "structure"}
    name : str
        As printed.
    unit : str
        Empty for a pure number.
    digits : int
        Decimals that mean something.
    text : str
        How it is measured here.
    source : str
    """

    key: str
    group: str
    name: str
    unit: str
    digits: int
    text: str
    source: str = OWN


_ALL = (
    Definition(
        key="tortuosity",
        group="path",
        name="Tortuosity",
        unit="",
        digits=3,
        text="Length of the path over the straight distance between its ends.",
        source=BULLITT,
    ),
    Definition(
        key="total_bending_deg",
        group="path",
        name="Total bending angle",
        unit="°",
        digits=1,
        text="Sum of the turns of the path's direction: the integral of its curvature over arc length.",
        source="do Carmo MP, Differential Geometry of Curves and Surfaces, 1976, section 5.7 (total curvature)",
    ),
    Definition(
        key="bend_radius_min_mm",
        group="path",
        name="Least bend radius",
        unit="mm",
        digits=2,
        text="Reciprocal of the largest curvature on the path.",
    ),
    Definition(
        key="bend_radius_min_at_mm",
        group="path",
        name="Least bend radius, where",
        unit="mm",
        digits=1,
        text="Arc length from the start of the sample of the path with the largest curvature.",
    ),
    Definition(
        key="infundibulopelvic_angle_deg",
        group="urinary",
        name="Infundibulopelvic angle, in space",
        unit="°",
        digits=1,
        text="Angle between the ureteropelvic axis (from the centre of the pelvis to the ureter's centre at the level of the "
        "lower pole) and the axis of the infundibulum (best line through its middle, towards the calyx). The kidney's outline is "
        "not in the lumen: the level is where the ureter is ureter_level_mm (a setting) from the centre of the pelvis.",
        source=ELBAHNASY,
    ),
    Definition(
        key="infundibulopelvic_angle_coronal_deg",
        group="urinary",
        name="Infundibulopelvic angle, coronal view",
        unit="°",
        digits=1,
        text="The same two axes seen from the front, as on the urogram for which the scores were made.",
        source=ELBAHNASY,
    ),
    Definition(
        key="infundibular_length_mm",
        group="urinary",
        name="Infundibular length",
        unit="mm",
        digits=1,
        text="Straight distance from the lip of the pelvis to the bottom of the calyx. The lip is where the middle line leaves "
        f"for good what balls of {100 * PLATEAU:.0f} % of the largest ball reach in the pelvis or its arm; the bottom is where "
        f"the axis of the calyx, through the centre of its own widest part, meets the wall (a papilla's tip). {EDGE}",
        source=ELBAHNASY,
    ),
    Definition(
        key="infundibular_width_mm",
        group="urinary",
        name="Infundibular width",
        unit="mm",
        digits=2,
        text="Diameter of the circle with the area of the narrowest cross-section between the lip of the pelvis and the first "
        f"minor calyx (least running median over 2 mm). {EDGE}",
        source=ELBAHNASY,
    ),
    Definition(
        key="calyx_diameter_mm",
        group="urinary",
        name="Calyx diameter",
        unit="mm",
        digits=2,
        text="Width of the far half of what lies beyond the last branching: the median over all directions of the chords of a "
        "cross-section through the middle line, at its largest.",
    ),
    Definition(
        key="ureter_diameter_mean_mm",
        group="urinary",
        name="Ureter diameter, mean",
        unit="mm",
        digits=2,
        text="Mean over its length of the diameter of the circle with the area of the cross-section, from the ureter's end in "
        "the image to the ureteropelvic junction.",
    ),
    Definition(
        key="ureter_diameter_min_mm",
        group="urinary",
        name="Ureter diameter, least",
        unit="mm",
        digits=2,
        text="Least of these diameters (running median over 2 mm).",
    ),
    Definition(
        key="pelvis_diameter_mm",
        group="urinary",
        name="Pelvis, largest ball",
        unit="mm",
        digits=2,
        text="Diameter of the largest ball that fits into the renal pelvis, to the edge in the CT. The pelvis is where the "
        "collecting system is widest up to the first neck past its division on the way to a calyx, of under "
        f"{100 * NECK:.0f} % of that width; one that divides before it widens has such a place in each arm.",
        source="Hildebrand T and Rüegsegger P, J Microsc 1997; 185(1): 67-75 (local thickness)",
    ),
    Definition(
        key="trachea_diameter_mm",
        group="airway",
        name="Trachea diameter",
        unit="mm",
        digits=2,
        text="Median over the middle half of the first branch of the diameter of the circle with the area of the cross-section.",
        source=WEIBEL,
    ),
    Definition(
        key="carinal_angle_deg",
        group="airway",
        name="Angle at the carina",
        unit="°",
        digits=1,
        text="Angle between the directions of the two main bronchi beyond the first branching.",
        source="Haskin PH and Goodman LR, AJR 1982; 139(5): 879-882 (interbronchial angle)",
    ),
    Definition(
        key="generation",
        group="airway",
        name="Generation",
        unit="",
        digits=0,
        text="Branchings between the trachea (0) and this branch.",
        source=WEIBEL,
    ),
    Definition(
        key="branch_length_mm",
        group="airway",
        name="Length",
        unit="mm",
        digits=1,
        text="Along the middle line from branching to branching or tip.",
        source=WEIBEL,
    ),
    Definition(
        key="branch_diameter_mm",
        group="airway",
        name="Diameter",
        unit="mm",
        digits=2,
        text="Median over the middle half of the branch of the width of the cross-section: the median of its chords in all "
        f"directions, most of which miss the neighbour beside a branching. {EDGE}",
        source=WEIBEL,
    ),
    Definition(
        key="branch_angle_deg",
        group="airway",
        name="Branch angle",
        unit="°",
        digits=1,
        text="Between the branch's direction past the branching and its parent's before it.",
        source=TAWHAI,
    ),
    Definition(
        key="stone_volume_mm3",
        group="stone",
        name="Volume",
        unit="mm³",
        digits=0,
        text="Voxels of the stone times the volume of one. A stone given as a point is grown from there above halfway between "
        "its core and what surrounds it.",
    ),
    Definition(
        key="stone_diameter_mm",
        group="stone",
        name="Largest diameter",
        unit="mm",
        digits=1,
        text="Largest distance between two points of the stone (voxel corners).",
    ),
    Definition(
        key="stone_hu_mean",
        group="stone",
        name="Density, mean",
        unit="HU",
        digits=0,
        text="Mean of the stone's voxels.",
    ),
    Definition(
        key="stone_hu_max",
        group="stone",
        name="Density, largest",
        unit="HU",
        digits=0,
        text="Largest of the stone's voxels.",
    ),
    Definition(
        key="structure_distance_min_mm",
        group="structure",
        name="Least distance",
        unit="mm",
        digits=2,
        text="Least distance of the path's centre line to the voxels of the structure's mask; 0 inside.",
    ),
    Definition(
        key="structure_distance_min_at_mm",
        group="structure",
        name="Least distance, where",
        unit="mm",
        digits=1,
        text="Arc length from the start where that is.",
    ),
    Definition(
        key="structure_distance_mean_mm",
        group="structure",
        name="Mean distance",
        unit="mm",
        digits=2,
        text="Mean over arc length of that distance.",
    ),
)

DEFINITIONS = {definition.key: definition for definition in _ALL}
GROUPS = {
    "path": "Path",
    "urinary": "Collecting system",
    "airway": "Airway",
    "stone": "Stones",
    "structure": "Structures near the path",
}
