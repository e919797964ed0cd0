"""The first 3D view: all of the path and of the lumen about it is on the screen, and a far part does not make it small."""

import numpy as np
import pytest

from tubeplan_viz.recording.blueprint import FIELD_OF_VIEW, surroundings, viewpoint

BOW = np.column_stack([60.0 * np.cos(np.linspace(0.0, np.pi, 50)), np.zeros(50), 60.0 * np.sin(np.linspace(0.0, np.pi, 50))])


def off_axis(points: np.ndarray, eye: object) -> float:
    """Largest angle in rad between the line of sight and the direction of a point."""
    sight = eye.target - eye.position
    ways = points - eye.position
    cosine = ways @ sight / (np.linalg.norm(ways, axis=1) * np.linalg.norm(sight))
    return float(np.arccos(cosine.min()))


@pytest.mark.parametrize("frame", ["LPS", "mesh"])
def test_the_path_and_the_lumen_beside_it_are_in_the_field_of_view(frame: str) -> None:
    beside = BOW[:10] + np.array([20.0, 5.0, -15.0])
    eye = viewpoint(BOW, frame, wall=beside)
    assert off_axis(np.concatenate([BOW, beside]), eye) < 0.5 * FIELD_OF_VIEW
    # Without the wall the eye would not have gone so far away.
    assert off_axis(np.concatenate([BOW, beside]), viewpoint(BOW, frame)) > off_axis(BOW, eye)


def test_what_lies_far_off_leaves_the_view_as_it_is() -> None:
    far = np.array([[0.0, 0.0, 900.0], [400.0, 0.0, 0.0]])
    assert not len(surroundings(BOW, far))
    alone, beside = viewpoint(BOW, "mesh"), viewpoint(BOW, "mesh", wall=far)
    np.testing.assert_array_equal(alone.position, beside.position)
