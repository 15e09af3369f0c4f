"""Robot descriptions: robot files, the model made from them, servo maps, meshes, failures."""
