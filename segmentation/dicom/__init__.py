"""DICOM folder to volume, fail closed: the only home of pydicom and highdicom."""
