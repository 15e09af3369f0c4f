import numpy as np

from hexctl.backends.sim.terrain import make_floor
from hexctl.backends.sim.world import World
from hexctl.record.ground import MAX_VERTICES, make_mesh


def test_an_even_floor_is_two_triangles_around_the_whole_path() -> None:
    mesh = make_mesh(None, np.array([4.0, 0.0]))
    assert len(mesh.triangles) == 2
    assert mesh.positions[:, 0].min() < -1
    assert mesh.positions[:, 0].max() > 5


def test_bumps_have_the_heights_of_the_floor_and_face_up() -> None:
    floor = make_floor(World(roughness_m=0.01), seed=3)
    assert floor.heights_m is not None
    mesh = make_mesh(floor.heights_m, np.array([1.0, 0.0]))
    axis = np.linspace(-8, 8, 400)
    column, row = (np.searchsorted(axis, mesh.positions[:, i].astype(float) - 1e-5) for i in (0, 1))
    np.testing.assert_allclose(mesh.positions[:, 2], floor.heights_m[row, column], atol=1e-6)
    corners = mesh.positions[mesh.triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (facing[:, 2] > 0).all()
    assert (mesh.normals[:, 2] > 0).all()


def test_a_long_walk_over_bumps_stays_small() -> None:
    floor = make_floor(World(roughness_m=0.01), seed=3)
    mesh = make_mesh(floor.heights_m, np.array([50.0, 50.0]))
    assert len(mesh.positions) <= 1.1 * MAX_VERTICES
