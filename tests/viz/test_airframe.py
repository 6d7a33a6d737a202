"""The drawn aircraft points the right way: nose forward, green light right, fin up."""

import numpy as np

from ahrs_service.viz.airframe import PORT_RED, STARBOARD_GREEN, aircraft

PAINT = (45, 110, 225)


def test_lights_are_on_the_right_wing_tips():
    mesh = aircraft(PAINT)
    green = mesh.positions[(mesh.colours == STARBOARD_GREEN).all(axis=1)]
    red = mesh.positions[(mesh.colours == PORT_RED).all(axis=1)]
    assert green[:, 1].min() > 1.9
    assert red[:, 1].max() < -1.9


def test_nose_is_forward_and_fin_is_up():
    mesh = aircraft(PAINT)
    highest = mesh.positions[np.argmin(mesh.positions[:, 2])]
    assert highest[0] < -1.5
    assert highest[2] < -0.7
    assert abs(highest[1]) < 0.05
    ends = (
        mesh.positions[np.argmax(mesh.positions[:, 0])],
        mesh.positions[np.argmin(mesh.positions[:, 0])],
    )
    assert np.abs(ends[0][1]) < 0.1


def test_it_is_symmetric_left_and_right():
    points = np.round(aircraft(PAINT).positions.astype(np.float64), 4) + 0.0
    mirrored = points * [1.0, -1.0, 1.0] + 0.0
    assert {tuple(p) for p in points.tolist()} == {tuple(p) for p in mirrored.tolist()}


def test_normals_are_unit_and_follow_the_winding():
    mesh = aircraft(PAINT)
    a, b, c = mesh.positions[0::3], mesh.positions[1::3], mesh.positions[2::3]
    area = np.cross(b - a, c - a)
    solid = np.linalg.norm(area, axis=1) > 1e-6
    normals = mesh.normals[0::3]
    np.testing.assert_allclose(np.linalg.norm(normals[solid], axis=1), 1.0, atol=1e-5)
    assert (np.einsum("ij,ij->i", area[solid], normals[solid]) > 0.0).all()


def test_the_top_of_the_wing_faces_up():
    mesh = aircraft(PAINT)
    centre = mesh.positions.reshape(-1, 3, 3).mean(axis=1)
    wing = (np.abs(centre[:, 1]) > 0.5) & (np.abs(centre[:, 1]) < 1.9) & (centre[:, 0] > -0.5)
    normals = mesh.normals[0::3][wing]
    assert normals[:, 2].min() < -0.9
    assert normals[:, 2].max() > 0.9
