"""A finished run for other programs: 3D Slicer, DICOM, STL, glTF, tables, one HTML file with the viewer inside."""

from tubeplan_viz.exports.run import EXPORT_FILES, FORMATS, ExportError, export_run

__all__ = ["EXPORT_FILES", "FORMATS", "ExportError", "export_run"]
