"""Photos of a room and their features, which the stages of a reconstruction begin with."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from clgs.opencl.device import Device
from clgs.poses.pycolmap_child import quiet_pycolmap
from clgs.poses.stages.features import extract
from clgs.poses.workspace import OnProgress, Workspace
from tests.data.folders import write_room_photos


@contextmanager
def room_workspace(
    folder: Path, photos: int, on_progress: OnProgress = lambda *step: None
) -> Iterator[Workspace]:
    """A workspace in ``folder``, with features; poses are ``tests.data.folders.room_poses``'."""
    write_room_photos(folder / "images", photos)
    names, cameras = [f"{number}.png" for number in range(photos)], [0] * photos
    with quiet_pycolmap("a test") as pycolmap:
        workspace = Workspace(
            pycolmap, Device(), folder / "images", folder, names, cameras, 0, on_progress
        )
        pycolmap.set_random_seed(0)
        extract(workspace, 320, quick=False)
        yield workspace
