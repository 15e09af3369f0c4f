"""Robot descriptions: robot files, their models, servo maps, meshes, failures."""
