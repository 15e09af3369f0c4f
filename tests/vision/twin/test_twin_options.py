import pytest

from hexctl.vision.twin.twin_options import parse_point


def test_a_point_is_three_numbers() -> None:
    assert parse_point("-1.63,0,1.63") == (-1.63, 0.0, 1.63)
    for text in ("1,2", "1,2,3,4", "x,y,z", "nan,0,1", "1000,0,1", ""):
        with pytest.raises(ValueError, match="allowed: X,Y,Z in m"):
            parse_point(text)
