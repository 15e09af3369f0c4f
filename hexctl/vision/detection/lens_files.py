"""Camera calibrations of other tools, in the keys of ROS's camera_info.

Reads ROS's own files and OpenCV's FileStorage (YAML, XML and JSON).
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from hexctl.errors import InputError, shown
from hexctl.files import read_file
from hexctl.robot.configs import MOST_BYTES, mapping_of
from hexctl.robot.formats.xml_text import parse_xml

#: Other names of the keys, in lower case without underscores.
KEYS = {
    "image_width": ("imagewidth", "width"),
    "image_height": ("imageheight", "height"),
    "camera_matrix": ("cameramatrix", "intrinsicmatrix", "k", "mtx"),
    "distortion_coefficients": (
        "distortioncoefficients",
        "distcoeffs",
        "distcoeff",
        "distortion",
        "d",
        "dist",
    ),
    "distortion_model": ("distortionmodel", "cameramodel"),
}

#: Keys of a size: width and height, in this order.
SIZES = ("imagesize", "size")

#: Models by other tools' names, in lower case without separators; the number of coefficients decides
#: between the two of Brown and Conrady.
MODELS = {
    **dict.fromkeys(("plumbbob", "brownconrady", "pinhole", "opencv"), "plumb_bob"),
    **dict.fromkeys(("perspective", "none", ""), "plumb_bob"),
    **dict.fromkeys(("rationalpolynomial", "rational", "fullopencv"), "rational_polynomial"),
    **dict.fromkeys(
        ("equidistant", "fisheye", "opencvfisheye", "kannalabrandt", "kannalabrandt4"), "equidistant"
    ),
}

#: Numbers that a model may have; missing ones are 0, and 12 and 14 have a thin prism and a tilted sensor too.
COUNTS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (5, 8, 12, 14), "equidistant": (4,)}
LEAST_COUNTS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}


def read_calibration(path: Path) -> dict[str, Any]:
    """Content of a calibration in the keys of ROS; others are left out. Raises InputError."""
    try:
        content = read_file(path, MOST_BYTES)
    except OSError as error:
        raise InputError(f"{path}: cannot be read as text: {error}") from error
    if content.lstrip().startswith(b"<"):
        values = _of_xml(content, path)
    else:  # FileStorage has a header and tags outside YAML
        content = re.sub(rb"^%YAML[: ]1\.\d\s*", b"", content).replace(b"!!opencv-matrix", b"")
        values = mapping_of(content, path)
    return _named(values, path)


def complete(model: str, coefficients: list[float], path: Path) -> list[float]:
    """Coefficients of a model, with the missing ones as 0. Raises InputError for a wrong number of them."""
    if len(coefficients) not in COUNTS[model]:
        allowed = ", ".join(map(str, COUNTS[model]))
        raise InputError(
            f"{path}: distortion_coefficients.data: got {len(coefficients)} numbers; "
            f"allowed: {allowed} for {model}"
        )
    return coefficients + [0.0] * (LEAST_COUNTS[model] - len(coefficients))


def _of_xml(content: bytes, path: Path) -> dict[str, Any]:
    try:
        root = parse_xml(content)
    except ValueError as error:
        raise InputError(f"{path}: {error}; allowed: OpenCV's FileStorage") from error
    return {one.tag: _xml_value(one) for one in root}


def _xml_value(element: Element) -> Any:
    if len(element):
        return {one.tag: _xml_value(one) for one in element}
    words = (element.text or "").split()
    return words if element.tag == "data" or len(words) > 1 else "".join(words)


def _named(values: dict[str, Any], path: Path) -> dict[str, Any]:
    plain = {re.sub(r"_", "", str(key)).lower(): value for key, value in values.items()}
    found: dict[str, Any] = {}
    for key, names in KEYS.items():
        found |= next(({key: plain[name]} for name in names if plain.get(name) is not None), {})
    size = next((plain[name] for name in SIZES if plain.get(name) is not None), None)
    if size is not None:
        if not isinstance(size, list) or len(size) != 2:
            raise InputError(f"{path}: image size: got {shown(size)}; allowed: 2 numbers")
        found = dict(zip(("image_width", "image_height"), size, strict=True)) | found
    for key, rows in (("camera_matrix", 3), ("distortion_coefficients", 1)):
        if isinstance(found.get(key), list):
            found[key] = _matrix(found[key], rows)
    found["distortion_model"] = _model(found, plain, path)
    return found


def _matrix(values: list[Any], rows: int) -> dict[str, Any]:
    """A matrix of nested or flat lists."""
    flat = [each for row in values for each in (row if isinstance(row, list) else [row])]
    return {"rows": rows, "cols": max(1, len(flat) // rows), "data": flat}


def _model(found: Mapping[str, Any], plain: Mapping[str, Any], path: Path) -> str:
    name = str(found.get("distortion_model") or "")
    model = MODELS.get(re.sub(r"[^a-z0-9]", "", name.lower()))
    if model is None:
        raise InputError(
            f"{path}: distortion_model: got {shown(name)}; allowed: plumb_bob, rational_polynomial or "
            "equidistant"
        )
    if str(plain.get("fisheyemodel", "0")) not in ("0", "False"):
        return "equidistant"
    coefficients = found.get("distortion_coefficients")
    data = coefficients.get("data") if isinstance(coefficients, dict) else None
    count = len(data) if isinstance(data, list) else 0
    if count == 4 and not name and "fisheyemodel" not in plain:
        raise InputError(
            f"{path}: distortion_model: got none, with 4 coefficients, which may be of either lens; allowed: "
            "the key distortion_model: plumb_bob, or distortion_model: equidistant for a fisheye"
        )
    return (
        "rational_polynomial"
        if count in COUNTS["rational_polynomial"][1:] and model == "plumb_bob"
        else model
    )
