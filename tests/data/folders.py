"""Small data sets written to a folder."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import map_coordinates

from clgs.scene.camera import Camera


def look_at(position: np.ndarray, target: np.ndarray | None = None) -> np.ndarray:
    """OpenCV camera-to-world (4, 4) at ``position`` looking at ``target``, z of the world up."""
    forward = (np.zeros(3) if target is None else target) - position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    matrix[:3, 3] = position
    return matrix


def ring(count: int, radius: float = 4.0, height: float = 1.5) -> list[np.ndarray]:
    """Camera-to-world matrices on a circle around the origin."""
    angles = np.arange(count) * (2 * np.pi / count)
    return [look_at(np.array([radius * np.cos(a), radius * np.sin(a), height])) for a in angles]


def project(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of points (N, 3) in the camera's world."""
    local = points @ camera.rotation.T + camera.translation
    return local[:, :2] / local[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)


def opengl(camera_to_world: np.ndarray) -> list[list[float]]:
    """The same pose with the camera's y and z flipped."""
    return (camera_to_world * [1, -1, -1, 1]).tolist()


def noise_image(width: int, height: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.uint8)


def orientation(tag: object) -> Image.Exif:
    """The metadata of a photo with this EXIF orientation."""
    exif = Image.Exif()
    exif[0x0112] = tag
    return exif


def write_noise(
    folder: Path, count: int = 3, size: tuple[int, int] = (8, 6), kind: str = "png"
) -> Path:
    """A folder of photos 0.png, 1.png and so on that have nothing in common; returns it."""
    folder.mkdir(exist_ok=True)
    for number in range(count):
        Image.fromarray(noise_image(*size, number)).save(folder / f"{number}.{kind}")
    return folder


def write_video(path: Path, frames: Iterable[np.ndarray], **options: object) -> Path:
    """A video of frames (H, W, 3); options as of imageio_ffmpeg.write_frames; returns its path."""
    library = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    first, *others = map(np.ascontiguousarray, frames)
    writer = library.write_frames(str(path), first.shape[1::-1], **options)
    writer.send(None)
    for frame in (first, *others):
        writer.send(frame)
    writer.close()
    return path


def write_transforms(
    root: Path, count: int = 10, size: tuple[int, int] = (40, 30), **shared
) -> dict:
    """A nerfstudio folder of noise images; returns the JSON document that was written."""
    (root / "images").mkdir(parents=True, exist_ok=True)
    width, height = size
    lens = {"fl_x": 50.0, "fl_y": 50.0, "cx": width / 2, "cy": height / 2}
    document = lens | {"w": width, "h": height} | shared | {"frames": []}
    for number, pose in enumerate(ring(count)):
        name = f"images/{number:03d}.png"
        Image.fromarray(noise_image(width, height, number)).save(root / name)
        document["frames"].append({"file_path": name, "transform_matrix": opengl(pose)})
    save_json(root, document)
    return document


def save_json(root: Path, document: object, name: str = "transforms.json") -> None:
    (root / name).write_text(json.dumps(document))


def move_cameras(file: Path, place: Callable[[np.ndarray], np.ndarray]) -> None:
    """Put the cameras of a file of transforms elsewhere, each by the place where it is."""
    document = json.loads(file.read_text())
    for frame in document["frames"]:
        pose = np.array(frame["transform_matrix"], np.float64)
        pose[:3, 3] = place(pose[:3, 3])
        frame["transform_matrix"] = pose.tolist()
    save_json(file.parent, document, file.name)


def write_blender(root: Path, train: int = 8, test: int = 3, size: int = 40) -> None:
    """A Synthetic-NeRF folder: a grey ball of radius 0.5 at the origin, RGBA, by ray casting."""
    grid = (np.arange(size) + 0.5 - size / 2) / size
    x, y = np.meshgrid(grid, grid)
    for split, count in (("train", train), ("test", test)):
        (root / split).mkdir(parents=True)
        frames = []
        for number, pose in enumerate(ring(count)):
            rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ pose[:3, :3].T
            rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
            along = -rays @ pose[:3, 3]
            nearest = np.linalg.norm(pose[:3, 3] + rays * along[..., None], axis=-1)
            image = np.full((size, size, 4), 128, np.uint8)
            image[..., 3] = np.where(nearest < 0.5, 255, 0)
            Image.fromarray(image).save(root / split / f"r_{number}.png")
            frames.append({"file_path": f"./{split}/r_{number}", "transform_matrix": opengl(pose)})
        document = {"camera_angle_x": 2 * np.arctan(0.5), "frames": frames}
        save_json(root, document, f"transforms_{split}.json")


def write_colmap(
    root: Path,
    *,
    text: bool = False,
    shared: bool = True,
    rigs: bool = True,
    model: str = "PINHOLE",
) -> None:
    """A COLMAP folder of ten 41x31 noise images with 20 points, written by pycolmap."""
    import pycolmap

    width, height = 41, 31
    reconstruction = pycolmap.Reconstruction()
    cameras = range(1, 2 if shared else 11)
    for number in cameras:
        camera = pycolmap.Camera.create_from_model_name(number, model, 50.0, width, height)
        if len(camera.params) > 4:
            camera.params = [*camera.params[:4], *([0.01] * (len(camera.params) - 4))]
        reconstruction.add_camera_with_trivial_rig(camera)
    (root / "images").mkdir(parents=True)
    for number, pose in enumerate(ring(10), 1):
        name = f"{number:03d}.png"
        Image.fromarray(noise_image(width, height, number)).save(root / "images" / name)
        inverse = np.linalg.inv(pose)
        image = pycolmap.Image(
            name=name,
            keypoints=np.zeros((2, 2)),
            camera_id=1 if shared else number,
            image_id=number,
        )
        rigid = pycolmap.Rigid3d(pycolmap.Rotation3d(inverse[:3, :3]), inverse[:3, 3])
        reconstruction.add_image_with_trivial_frame(image, rigid)
    rng = np.random.default_rng(1)
    for xyz in rng.uniform(-1, 1, (20, 3)):
        reconstruction.add_point3D(xyz, pycolmap.Track(), np.array([10, 20, 30], np.uint8))
    folder = root / "sparse" / "0"
    folder.mkdir(parents=True)
    (reconstruction.write_text if text else reconstruction.write_binary)(folder)
    if not rigs:
        for name in ("rigs", "frames"):
            (folder / f"{name}.{'txt' if text else 'bin'}").unlink()


def room_poses(count: int) -> list[np.ndarray]:
    """Camera-to-world matrices on an arc before the corner of ``room_image``."""
    poses = []
    for number, angle in enumerate(np.radians(np.linspace(20.0, 70.0, count))):
        height = 1.2 + 0.5 * (number % 3)
        position = np.array([4.5 * np.cos(angle), 4.5 * np.sin(angle), height])
        poses.append(look_at(position, np.array([0.4, 0.4, 0.8])))
    return poses


def room_image(camera_to_world: np.ndarray, size: tuple[int, int], focal: float) -> np.ndarray:
    """RGB image (H, W, 3) of the corner of a textured room: the planes x = 0, y = 0 and z = 0."""
    width, height = size
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    rays = np.stack([x / focal, y / focal, np.ones_like(x)], axis=-1) @ camera_to_world[:3, :3].T
    origin = camera_to_world[:3, 3]
    with np.errstate(divide="ignore"):
        along = np.where(rays < 0, -origin / rays, np.inf)
    wall = along.argmin(axis=-1)
    hits = origin + rays * along.min(axis=-1)[..., None]
    image = np.zeros((height, width))
    for axis in range(3):
        on_wall = wall == axis
        image[on_wall] = _texture(np.delete(hits[on_wall], axis, axis=1), axis)
    return np.dstack([np.rint(image).astype(np.uint8)] * 3)


def _texture(points: np.ndarray, seed: int) -> np.ndarray:
    """Blobs of three sizes: bicubic noise at ``points`` (N, 2), values of 0 to 255."""
    rng = np.random.default_rng(seed)
    value = np.zeros(len(points))
    for cells_per_unit, weight in ((4, 0.4), (10, 0.35), (24, 0.25)):
        grid = rng.uniform(0, 255, (128, 128))
        at = (points * cells_per_unit).T
        value += weight * map_coordinates(grid, at, order=3, mode="grid-wrap")
    return np.clip((value - 128) * 1.6 + 128, 0, 255)


def write_room_photos(
    folder: Path, count: int, size: tuple[int, int] = (320, 240)
) -> list[np.ndarray]:
    """Photos of the room alone; returns camera-to-world matrices."""
    folder.mkdir(parents=True)
    poses = room_poses(count)
    for number, pose in enumerate(poses):
        Image.fromarray(room_image(pose, size, float(size[0]))).save(folder / f"{number}.png")
    return poses


def write_room(root: Path, count: int, size: tuple[int, int] = (320, 240)) -> list[np.ndarray]:
    """Photos of the room with poses in transforms.json; returns camera-to-world matrices."""
    poses = write_room_photos(root / "images", count, size)
    frames = [
        {"file_path": f"images/{number}.png", "transform_matrix": opengl(pose)}
        for number, pose in enumerate(poses)
    ]
    save_json(root, {"fl_x": float(size[0]), "frames": frames})
    return poses
