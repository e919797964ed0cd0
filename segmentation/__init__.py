"""CT voxels to the closed surface of one lumen; knows nothing of instruments."""
