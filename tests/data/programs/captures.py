"""One made capture in the forms of several programs: the same photos, cameras and points."""

import functools
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.data.folders import room_image, room_poses

SIZE = WIDTH, HEIGHT = 160, 120
COUNT = 6
PLACE = 46.9481, 7.4474, 553.25
"""Latitude, longitude and altitude of the world's origin."""


@dataclass
class Capture:
    """Camera-to-world matrices (4, 4) in OpenCV's axes, z of the world up, and a lens."""

    folder: Path
    focal: tuple[float, float] = (150.0, 150.0)
    centre: tuple[float, float] = (81.5, 58.25)
    coefficients: dict[str, float] = field(default_factory=dict)
    model: str = "FULL_OPENCV"
    poses: list[np.ndarray] = field(default_factory=lambda: room_poses(COUNT))
    points: np.ndarray = field(
        default_factory=lambda: np.random.default_rng(0).uniform(0.1, 1.5, (50, 3))
    )

    @property
    def names(self) -> list[str]:
        return [f"IMG_{number:04d}.png" for number in range(len(self.poses))]

    def value(self, name: str) -> float:
        return self.coefficients.get(name, 0.0)

    def photos(self, folder: Path, names: list[str] | None = None) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for name, pose in zip(names or self.names, self.poses, strict=True):
            kind = Path(name).suffix.lower()
            (folder / name).write_bytes(_photo(pose.tobytes(), self.focal[0], kind))

    def form(self, name: str) -> Path:
        """The folder of the capture in the form of a program, in place of an earlier one."""
        root = self.folder / name
        shutil.rmtree(root, ignore_errors=True)
        root.mkdir(parents=True)
        FORMS[name](self, root)
        return root


@functools.cache  # many tests take the same photos
def _photo(pose: bytes, focal: float, kind: str) -> bytes:
    file = io.BytesIO()
    picture = Image.fromarray(room_image(np.frombuffer(pose).reshape(4, 4), SIZE, focal))
    picture.save(file, Image.registered_extensions()[kind])
    return file.getvalue()


def write_colmap_form(capture: Capture, root: Path) -> None:
    capture.photos(root / "images")
    sparse = root / "sparse" / "0"
    sparse.mkdir(parents=True)
    order = {
        "PINHOLE": "",
        "FULL_OPENCV": "k1 k2 p1 p2 k3 k4 k5 k6",
        "OPENCV_FISHEYE": "k1 k2 k3 k4",
    }
    values = [*capture.focal, *capture.centre, *map(capture.value, order[capture.model].split())]
    words = " ".join(repr(float(value)) for value in values)
    (sparse / "cameras.txt").write_text(f"1 {capture.model} {WIDTH} {HEIGHT} {words}\n")
    lines = []
    for number, (name, pose) in enumerate(zip(capture.names, capture.poses, strict=True), 1):
        inverse = np.linalg.inv(pose)
        x, y, z, w = Rotation.from_matrix(inverse[:3, :3]).as_quat()
        lines += [f"{number} {_words([w, x, y, z, *inverse[:3, 3]])} 1 {name}\n\n"]
    (sparse / "images.txt").write_text("".join(lines))
    points = [f"{i} {_words(at)} 9 90 200 0.5\n" for i, at in enumerate(capture.points, 1)]
    (sparse / "points3D.txt").write_text("".join(points))


def _words(values: object) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(np.asarray(values)))


def earth_centred(place: tuple[float, float, float]) -> np.ndarray:
    """The matrix (4, 4) from metres east, north and up of a place to the Earth's centre.

    By the definition of geodetic coordinates: the normal of the ellipsoid, prime vertical.
    """
    latitude, longitude, altitude = np.radians(place[0]), np.radians(place[1]), place[2]
    a, b = 6_378_137.0, 6_356_752.314245179
    level = np.cos(latitude) * np.array([np.cos(longitude), np.sin(longitude)])
    up = np.append(level, np.sin(latitude))
    normal = a * a / np.hypot(a * np.cos(latitude), b * np.sin(latitude))
    foot = normal * up * [1, 1, b * b / (a * a)]
    east = np.cross([0.0, 0.0, 1.0], up)
    east /= np.linalg.norm(east)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([east, np.cross(up, east), up, foot + altitude * up])
    return matrix


def metashape_xml(
    capture: Capture,
    world: np.ndarray | None = None,
    scale: float = 2.5,
    component: bool = False,
    moved: tuple[float, float, float] = (12.0, -3.0, 5.0),
    extra: str = "",
) -> str:
    """The file of cameras of a turned and scaled chunk; ``world`` (4, 4) follows its transform."""
    turn = Rotation.from_rotvec([0.3, -0.5, 1.1]).as_matrix()
    cameras = []
    for number, (name, pose) in enumerate(zip(capture.names, capture.poses, strict=True)):
        inner = np.eye(4)
        inner[:3, :3] = turn.T @ pose[:3, :3]
        inner[:3, 3] = turn.T @ (pose[:3, 3] - moved) / scale
        own = 'component_id="3" ' if component else ""
        cameras.append(
            f'<camera id="{number}" sensor_id="7" {own}label="{name.removesuffix(".png")}" '
            f'enabled="true"><transform>{_words(inner)}</transform></camera>'
        )
    world = np.eye(4) if world is None else world
    turn, origin = world[:3, :3] @ turn, world[:3, :3] @ moved + world[:3, 3]
    transform = (
        f'<transform><rotation locked="true">{_words(turn)}</rotation><translation locked="true">'
        f'{_words(origin)}</translation><scale locked="true">{scale!r}</scale></transform>'
    )
    components = f'<components><component id="3">{transform}</component></components>'
    fisheye = capture.model == "OPENCV_FISHEYE"
    calibration = {
        "f": capture.focal[1],
        "cx": capture.centre[0] - WIDTH / 2,
        "cy": capture.centre[1] - HEIGHT / 2,
        "b1": capture.focal[0] - capture.focal[1],
        **{name: capture.value(name) for name in ("k1", "k2", "k3")},
        "k4": capture.value("k4") if fisheye else 0.0,
        "p1": capture.value("p2"),
        "p2": capture.value("p1"),
    }
    fields = "".join(f"<{name}>{value!r}</{name}>" for name, value in calibration.items())
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0">\n'
        '<chunk label="Chunk 1" enabled="true"><sensors next_id="8">\n'
        f'<sensor id="7" label="A camera" type="{"fisheye" if fisheye else "frame"}">'
        f'<resolution width="{WIDTH}" height="{HEIGHT}"/>'
        '<calibration class="initial"><f>99</f></calibration><calibration class="adjusted">'
        f'<resolution width="{WIDTH}" height="{HEIGHT}"/>{fields}</calibration>'
        "</sensor></sensors>\n"
        f"{components if component else ''}<cameras>{''.join(cameras[:2])}"
        f'<group id="0" label="g">{"".join(cameras[2:])}</group>{extra}</cameras>'
        f"{'' if component else transform}</chunk></document>\n"
    )


def write_metashape(capture: Capture, root: Path) -> None:
    capture.photos(root / "photos")
    (root / "cameras.xml").write_text(metashape_xml(capture))


def write_metashape_on_earth(capture: Capture, root: Path) -> None:
    """The component's origin is at a place, as Metashape 2 writes it."""
    capture.photos(root)
    world = earth_centred(PLACE)
    text = metashape_xml(capture, world, component=True, moved=(0.0, 0.0, 0.0))
    (root / "export.xml").write_text(text)


def write_realityscan(capture: Capture, root: Path) -> None:
    capture.photos(root / "images")
    lines = ["#cameras 6", "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"]
    for name, pose in zip(capture.names, capture.poses, strict=True):
        axes = pose[:3, :3] * [1, -1, -1]
        heading = np.degrees(np.arctan2(axes[0, 1], axes[1, 1]))
        pitch, roll = np.degrees([np.arcsin(axes[2, 1]), np.arctan2(-axes[2, 0], axes[2, 2])])
        values = [*pose[:3, 3], heading, pitch, roll, capture.focal[0] * 36 / WIDTH]
        values += [
            (capture.centre[0] - WIDTH / 2) / WIDTH,
            (capture.centre[1] - HEIGHT / 2) / WIDTH,
        ]
        values += [capture.value(key) for key in ("k1", "k2", "k3")]
        values += [0.0, capture.value("p1"), capture.value("p2")]
        lines.append(",".join([name, *(repr(float(value)) for value in values)]))
    (root / "parameters.csv").write_text("\n".join(lines) + "\n")
    body = "\n".join(_words(point) for point in capture.points)
    (root / "points.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex {len(capture.points)}\nproperty double x\n"
        f"property double y\nproperty double z\nend_header\n{body}\n"
    )


def opensfm_camera(capture: Capture) -> dict[str, object]:
    types = {"PINHOLE": "perspective", "FULL_OPENCV": "brown", "OPENCV_FISHEYE": "fisheye_opencv"}
    return {
        "projection_type": types[capture.model],
        "width": WIDTH,
        "height": HEIGHT,
        "focal_x": capture.focal[0] / WIDTH,
        "focal_y": capture.focal[1] / WIDTH,
        "c_x": (capture.centre[0] - WIDTH / 2) / WIDTH,
        "c_y": (capture.centre[1] - HEIGHT / 2) / WIDTH,
        **{name: value for name, value in capture.coefficients.items()},
    }


def write_opensfm(capture: Capture, root: Path) -> None:
    capture.photos(root / "images")
    shots = {}
    for name, pose in zip(capture.names, capture.poses, strict=True):
        inverse = np.linalg.inv(pose)
        vector = Rotation.from_matrix(inverse[:3, :3]).as_rotvec()
        shots[name] = {
            "camera": "v2 phone",
            "rotation": vector.tolist(),
            "translation": inverse[:3, 3].tolist(),
        }
    points = {
        str(i): {"coordinates": at.tolist(), "color": [9.0, 90.0, 200.0]}
        for i, at in enumerate(capture.points)
    }
    names = "latitude", "longitude", "altitude"
    model = {
        "cameras": {"v2 phone": opensfm_camera(capture)},
        "shots": shots,
        "points": points,
        "reference_lla": dict(zip(names, PLACE, strict=True)),
    }
    part = model | {"shots": {"IMG_0000.png": shots["IMG_0000.png"]}}
    (root / "opensfm").mkdir()
    (root / "opensfm" / "reconstruction.json").write_text(json.dumps([part, model]))


def write_opendronemap(capture: Capture, root: Path) -> None:
    capture.photos(root / "images")
    features = []
    for name, pose in zip(capture.names, capture.poses, strict=True):
        vector = Rotation.from_matrix(pose[:3, :3].T).as_rotvec()
        shot = {"filename": name, "camera": "phone", "rotation": vector.tolist()}
        shot["translation"] = pose[:3, 3].tolist()
        features.append({"type": "Feature", "properties": shot})
    (root / "odm_report").mkdir()
    shots = {"type": "FeatureCollection", "features": features}
    (root / "odm_report" / "shots.geojson").write_text(json.dumps(shots))
    (root / "cameras.json").write_text(json.dumps({"v2 phone": opensfm_camera(capture)}))


def write_polycam(capture: Capture, root: Path) -> None:
    names = [f"{1_000 + number}.png" for number in range(len(capture.poses))]
    capture.photos(root / "keyframes" / "corrected_images", names)
    for folder in ("cameras", "corrected_cameras"):
        (root / "keyframes" / folder).mkdir()
        for name, pose in zip(names, capture.poses, strict=True):
            matrix = (pose if folder.startswith("corrected") else pose + 1) * [1, -1, -1, 1]
            values = {f"t_{i}{j}": matrix[i, j] for i in range(3) for j in range(4)}
            values |= {"fx": capture.focal[0], "fy": capture.focal[1], "blur_score": 99.0}
            values |= {"cx": capture.centre[0], "cy": capture.centre[1]}
            values |= {"width": WIDTH, "height": HEIGHT}
            path = root / "keyframes" / folder / name.replace(".png", ".json")
            path.write_text(json.dumps(values))


def write_record3d(capture: Capture, root: Path, own: bool = True) -> None:
    capture.photos(root / "rgb", [f"{number}.png" for number in range(len(capture.poses))])
    poses = []
    for pose in capture.poses:
        quaternion = Rotation.from_matrix(pose[:3, :3] * [1, -1, -1]).as_quat()
        poses.append([*quaternion.tolist(), *pose[:3, 3].tolist()])
    fx, fy, cx, cy = *capture.focal, *capture.centre
    metadata = {"w": WIDTH, "h": HEIGHT, "K": [fx, 0, 0, 0, fy, 0, cx, cy, 1], "poses": poses}
    if own:
        metadata["K"] = [1.0] * 9
        metadata["perFrameIntrinsicCoeffs"] = [[fx, fy, cx, cy]] * len(poses)
    (root / "metadata.json").write_text(json.dumps(metadata))


FORMS: dict[str, Callable[[Capture, Path], None]] = {
    "colmap": write_colmap_form,
    "metashape": write_metashape,
    "metashape on the Earth": write_metashape_on_earth,
    "realityscan": write_realityscan,
    "opensfm": write_opensfm,
    "opendronemap": write_opendronemap,
    "polycam": write_polycam,
    "record3d": write_record3d,
    "record3d, one lens": lambda capture, root: write_record3d(capture, root, own=False),
}
